//! One open GigE camera. Blocks; lives in the camera's thread.
//!
//! What is told to it before frames are taken lies in `orders`, its features in `features`, the stream in `stream`.

use super::GigeSettings;
use super::names::{Names, Purpose};
use super::orders::Prepared;
use super::sequence::Numbers;
use super::stream::Running;
use crate::error::DriverError;
use crate::instrument::{CameraClock, Identity};
use aravis::prelude::*;
use aravis::{Camera, GvStreamOption, RangeCheckPolicy};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::time::Instant;

/// Held by whoever reads a camera's description: the library breaks when two are read at once (seen with 0.8.26: eight
/// cameras of one program).
static READING: Mutex<()> = Mutex::new(());

/// Waits until no other camera's description is being read.
pub(super) fn reading_alone() -> MutexGuard<'static, ()> {
    READING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// GigE Vision's control channel privilege register: bit 0 exclusive, bit 1 control.
const CONTROL_PRIVILEGE: u64 = 0x0A00;
const HAS_CONTROL: u32 = 0b11;

/// GigE Vision's clock, which stamps the leaders of frames: ticks in a second (two registers), its control (bit 1 latches
/// it), and what was latched (two registers).
const TICK_FREQUENCY: [u64; 2] = [0x093C, 0x0940];
const CLOCK_CONTROL: u64 = 0x0944;
const LATCH: u32 = 0b10;
const LATCHED: [u64; 2] = [0x0948, 0x094C];

/// An open camera.
pub(super) struct Device {
    pub(super) who: String,
    pub(super) camera: Camera,
    pub(super) names: Names,
    pub(super) settings: GigeSettings,
    control_lost: Arc<AtomicBool>,
    pub(super) running: Option<Running>,
    pub(super) prepared: Option<Prepared>,
    pub(super) numbers: Numbers,
    /// Counters of the last stream that has ended.
    pub(super) counters: Vec<(&'static str, u64)>,
}

impl Device {
    /// Opens a camera by its network address and takes control of it.
    pub(super) fn open(who: &str, address: &str, settings: &GigeSettings) -> Result<Self, DriverError> {
        let names = Names::new(settings.preset, &settings.features)
            .map_err(|why| refused(who, "reading the settings", &why, "Correct [camera.gige]."))?;
        let reading = reading_alone();
        let camera = Camera::new(Some(address)).map_err(|error| DriverError::Missing {
            who: who.to_owned(),
            why: error.message().to_owned(),
            hint: "Check power, cable, the camera's address (`ditd devices` lists what answers), and that no other program controls it."
                .to_owned(),
        })?;
        drop(reading);
        camera.set_range_check_policy(RangeCheckPolicy::Enable);
        if !settings.packet_socket {
            camera.gv_set_stream_options(GvStreamOption::PACKET_SOCKET_DISABLED);
        }
        let control_lost = Arc::new(AtomicBool::new(false));
        if let Some(device) = camera.device() {
            let flag = Arc::clone(&control_lost);
            // Comes from the library's heartbeat thread, 4 to 6 s after the camera has gone (measured).
            device.connect_control_lost(move |_| flag.store(true, Ordering::Release));
        }
        Ok(Self {
            who: who.to_owned(),
            camera,
            names,
            settings: settings.clone(),
            control_lost,
            running: None,
            prepared: None,
            numbers: Numbers::default(),
            counters: Vec::new(),
        })
    }

    /// Takes over the count of frames from the device that was there before.
    pub(super) fn go_on_from(&mut self, numbers: Numbers) {
        self.numbers = numbers;
    }

    /// The count of frames, for the next device.
    pub(super) fn numbers(&self) -> Numbers {
        self.numbers.clone()
    }

    /// Whether the camera has told that it is no longer ours.
    pub(super) fn is_lost(&self) -> bool {
        self.control_lost.load(Ordering::Acquire)
    }

    pub(super) fn identify(&self) -> Result<Identity, DriverError> {
        const DOING: &str = "asking who it is";
        let maker = self.camera.vendor_name().map_err(|error| self.trouble(DOING, &error))?;
        let model = self.camera.model_name().map_err(|error| self.trouble(DOING, &error))?;
        let serial = self
            .camera
            .device_serial_number()
            .or_else(|_| self.camera.string("DeviceID"))
            .map(|text| text.to_string())
            .unwrap_or_default();
        let firmware = ["DeviceFirmwareVersion", "DeviceVersion"]
            .iter()
            .find_map(|name| self.read(name).ok())
            .unwrap_or_default();
        Ok(Identity { maker: maker.to_string(), model: model.to_string(), serial, firmware })
    }

    /// Asks something harmless: an answer shows that the camera is there and ours.
    pub(super) fn check(&self) -> Result<(), DriverError> {
        const DOING: &str = "asking whether it is still there";
        if self.is_lost() {
            return Err(self.lost(DOING, "it no longer obeys this program".to_owned()));
        }
        if let Some(device) = self.camera.device().filter(|_| self.camera.is_gv_device()) {
            // A camera that has restarted answers, and has forgotten whom it obeys.
            let privilege = device.read_register(CONTROL_PRIVILEGE);
            let (_, value) = privilege.map_err(|error| self.lost(DOING, error.message().to_owned()))?;
            if value & HAS_CONTROL == 0 {
                return Err(self.lost(DOING, "it no longer obeys this program".to_owned()));
            }
            return Ok(());
        }
        let name = self.names.of(Purpose::Width).unwrap_or("Width");
        self.camera.integer(name).map(|_| ()).map_err(|error| self.lost(DOING, error.message().to_owned()))
    }

    /// What the clock shows that stamps the frames: latched between two moments of ours, then read. `None` for a camera
    /// that cannot do that; only one that is gone is an error.
    pub(super) fn clock(&self) -> Result<Option<CameraClock>, DriverError> {
        const DOING: &str = "asking for its clock";
        let Some(device) = self.camera.device().filter(|_| self.camera.is_gv_device()) else {
            return Ok(None);
        };
        let wide = |registers: [u64; 2]| -> Result<u64, aravis::glib::Error> {
            let [high, low] = registers;
            let (_, high) = device.read_register(high)?;
            let (_, low) = device.read_register(low)?;
            Ok(u64::from(high) << 32 | u64::from(low))
        };
        let latched = || -> Result<Option<CameraClock>, aravis::glib::Error> {
            let per_second = wide(TICK_FREQUENCY)?;
            let earliest = Instant::now();
            device.write_register(CLOCK_CONTROL, LATCH)?;
            let latest = Instant::now();
            let device_ns = nanoseconds(wide(LATCHED)?, per_second);
            Ok(device_ns.map(|device_ns| CameraClock { device_ns, earliest, latest }))
        };
        match latched() {
            Ok(clock) => Ok(clock),
            Err(error) => match self.trouble(DOING, &error) {
                gone @ DriverError::Lost { .. } => Err(gone),
                _ => Ok(None),
            },
        }
    }

    /// The error for a call that failed: the library's words name the feature.
    pub(super) fn trouble(&self, doing: &str, error: &aravis::glib::Error) -> DriverError {
        use aravis::DeviceError as Kind;
        let gone = matches!(
            error.kind::<Kind>(),
            Some(Kind::Timeout | Kind::NotConnected | Kind::TransferError | Kind::NotFound)
        );
        if gone || self.is_lost() {
            return self.lost(doing, error.message().to_owned());
        }
        refused(&self.who, doing, error.message(), "`ditd probe` prints what the camera offers.")
    }

    pub(super) fn lost(&self, doing: &str, why: String) -> DriverError {
        DriverError::lost(
            &self.who,
            doing,
            why,
            "Check the camera's power and network cable, and that no other program controls it.",
        )
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.stop();
    }
}

/// What the camera does not do, or must not be told.
pub(super) fn refused(who: &str, doing: &str, why: &str, hint: &str) -> DriverError {
    DriverError::refused(who, doing, why, hint)
}

/// Ticks of a clock in nanoseconds; `None` for a clock that does not tick.
fn nanoseconds(ticks: u64, per_second: u64) -> Option<u64> {
    let ns = u128::from(ticks) * 1_000_000_000 / (per_second != 0).then_some(u128::from(per_second))?;
    u64::try_from(ns).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_of_any_clock_are_nanoseconds() {
        assert_eq!(nanoseconds(62_500_000, 62_500_000), Some(1_000_000_000));
        assert_eq!(nanoseconds(7, 1_000_000_000), Some(7));
        // 580 years of a fast clock overflow no product, and one that does not tick is none.
        assert_eq!(nanoseconds(u64::MAX, 1_000_000_000), Some(u64::MAX));
        assert_eq!(nanoseconds(u64::MAX, 1000), None);
        assert_eq!(nanoseconds(5, 0), None);
    }
}
