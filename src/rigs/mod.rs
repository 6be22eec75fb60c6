//! Opens a rig: instruments on their wires, or the simulated world behind in-memory ones.

use crate::campaign::Instruments;
use crate::config::{Config, Pace, SIMULATED};
use ditd_drivers::TRIGGER_UNITS;
use ditd_drivers::error::DriverError;
use ditd_drivers::gige::GigeSettings;
use ditd_drivers::instrument::{Calibrator, Camera, TriggerUnit};
use ditd_drivers::wire::{Reopening, Wire, WireSettings};
use ditd_sim::rig::build::{self, BuildError};
use ditd_sim::rig::camera::{SimCamera, WorldState};
use ditd_sim::rig::chamber::World;
use ditd_sim::rig::config::RigConfig;
use ditd_sim::rig::plate::Plate;
use ditd_sim::rig::pulse::Pulse;
use ditd_sim::scene::library::OwnFile;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::mpsc;

mod known;
mod monitors;
pub mod served;
mod simulated;

pub use ditd_sim::rig::build::View;
pub use simulated::{calibrator_socket, simulate_plate, simulate_sensors, simulate_trigger};

/// Bytes that an in-memory wire holds before the sender waits: longer than any line of either protocol.
const PIPE_BYTES: usize = 4096;

/// Trigger pulses on their way to the simulated camera; when full, the trigger unit's task waits.
const PULSES_MAX: usize = 16;

/// Why a rig cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// An instrument's line.
    #[error(transparent)]
    Driver(#[from] DriverError),
    /// The simulated world.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// Asked for something that this program or config does not have.
    #[error("{0}")]
    Config(String),
}

impl OpenError {
    /// The process's exit status that stands for it.
    pub fn code(&self) -> u8 {
        match self {
            Self::Driver(error) if error.is_missing_device() => 3,
            Self::Driver(error) if error.is_interlock_or_limit() => 4,
            Self::Driver(_) => 1,
            Self::Build(_) | Self::Config(_) => 2,
        }
    }
}

/// The plate's true surface temperature at every exposure of this session, in K, in order of frame numbers.
type PlateLog = Arc<Mutex<Vec<f64>>>;

/// A rig that is ready to be opened; a simulated one is rendered.
#[derive(Debug)]
pub struct Prepared {
    config: Config,
    world: Option<Arc<World>>,
    log: PlateLog,
    begins: Beginning,
}

/// Where a session begins in the life of a run.
#[derive(Debug, Clone, Copy, Default)]
pub struct Beginning {
    /// Journal time, in ns.
    pub elapsed_ns: u64,
    /// Number of the camera's next frame, on a simulated rig.
    pub frames: u64,
    /// Injections so far, on a simulated rig.
    pub injections: u64,
    /// Whether another session of the same run came before.
    pub resumed: bool,
}

/// Number of the first frame of a simulated calibration: far from those of a campaign, so that the same camera never
/// draws the same noise twice.
pub const FIRST_CALIBRATION_FRAME: u64 = 1 << 24;

/// An open rig.
#[derive(Debug)]
pub struct Opened {
    /// The instruments.
    pub instruments: Instruments,
}

/// Renders the simulated world, if there is one.
///
/// # Errors
///
/// [`OpenError::Build`] naming what cannot be used.
pub fn prepare(
    config: &Config,
    view: View,
    folder: &Path,
    progress: &(dyn Fn(&str, f64) + Sync),
) -> Result<Prepared, OpenError> {
    // A rig that is simulated behind real lines has its world there.
    let world = match config.rig.as_ref().filter(|_| config.camera.address == SIMULATED) {
        Some(rig) => Some(Arc::new(build::world(rig, view, config.campaign.seed, folder, progress)?)),
        None => None,
    };
    let frames = if view == View::Bench { FIRST_CALIBRATION_FRAME } else { 0 };
    Ok(Prepared { world, begins: Beginning { frames, ..Beginning::default() }, ..without_world(config) })
}

/// The files of the user's own fuel and windows that the simulated world is made from, read and checked: their paths
/// from the campaign file's folder, and their texts.
///
/// # Errors
///
/// [`OpenError::Build`] naming the file and what is wrong.
pub fn own_files(config: &Config, folder: &Path) -> Result<Vec<OwnFile>, OpenError> {
    Ok(config.rig.as_ref().map_or(Ok(Vec::new()), |rig| build::own_files(rig, folder))?)
}

/// A rig whose simulated camera, if it has one, sees nothing: enough to make it safe.
pub fn without_world(config: &Config) -> Prepared {
    Prepared { config: config.clone(), world: None, log: PlateLog::default(), begins: Beginning::default() }
}

impl Prepared {
    /// The runtime of the campaign: virtual time when everything is simulated, real time otherwise.
    ///
    /// # Errors
    ///
    /// The system's words.
    pub fn runtime(&self) -> Result<tokio::runtime::Runtime, String> {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        builder.enable_all();
        builder.start_paused(self.is_virtual());
        builder.build().map_err(|error| format!("starting the runtime: {error}"))
    }

    /// Whether the campaign runs in virtual time.
    pub fn is_virtual(&self) -> bool {
        self.config.campaign.pace == Pace::Max && self.config.is_simulated()
    }

    /// Where this session begins.
    pub fn beginning(&self) -> Beginning {
        self.begins
    }

    /// The same rig, later in the life of a run: noise and shots go on where they were.
    #[must_use]
    pub fn beginning_at(self, begins: Beginning) -> Self {
        Self { begins, ..self }
    }

    /// Opens every instrument, the trigger unit first. When one cannot be opened, those that are open are made safe.
    /// Must run inside the campaign's runtime.
    ///
    /// # Errors
    ///
    /// [`OpenError`] naming the instrument.
    pub async fn open(&self) -> Result<Opened, OpenError> {
        let (pulses, received) = mpsc::channel(PULSES_MAX);
        let start = tokio::time::Instant::now();
        let mut trigger = self.open_trigger(pulses, start).await?;
        let others = match self.open_plate(start).await {
            Ok((mut plate, surface)) => {
                let rest = match self.open_monitors(start).await {
                    Ok(monitors) => {
                        let camera = self.open_camera(surface, received, start).await;
                        camera.map(|camera| (camera, monitors))
                    }
                    Err(error) => Err(error),
                };
                match rest {
                    Ok((camera, monitors)) => Ok((plate, camera, monitors)),
                    Err(error) => {
                        // The first trouble is the one to tell.
                        let _ = plate.make_safe().await;
                        Err(error)
                    }
                }
            }
            Err(error) => Err(error),
        };
        match others {
            Ok((plate, camera, monitors)) => {
                Ok(Opened { instruments: Instruments { plate, trigger, camera, monitors } })
            }
            Err(error) => {
                let _ = trigger.make_safe().await;
                Err(error)
            }
        }
    }

    /// Opens each instrument on its own and makes it safe at once, injector first: one that is missing does not keep
    /// the others from it. Returns the troubles.
    pub async fn make_safe(&self) -> Vec<OpenError> {
        let (pulses, received) = mpsc::channel(PULSES_MAX);
        let start = tokio::time::Instant::now();
        let mut trouble = Vec::new();
        match self.open_trigger(pulses, start).await {
            Ok(mut trigger) => trouble.extend(trigger.make_safe().await.err().map(OpenError::from)),
            Err(error) => trouble.push(error),
        }
        let mut surface = None;
        match self.open_plate(start).await {
            Ok((mut plate, simulated)) => {
                surface = simulated;
                let made = match plate.identify().await {
                    Ok(_) => plate.make_safe().await,
                    Err(error) => Err(error),
                };
                trouble.extend(made.err().map(OpenError::from));
            }
            Err(error) => trouble.push(error),
        }
        match self.open_camera(surface, received, start).await {
            Ok(mut camera) => trouble.extend(camera.make_safe().await.err().map(OpenError::from)),
            Err(error) => trouble.push(error),
        }
        trouble
    }

    async fn open_trigger(
        &self,
        pulses: mpsc::Sender<Pulse>,
        start: tokio::time::Instant,
    ) -> Result<Box<dyn TriggerUnit>, OpenError> {
        let config = &self.config;
        let driver = config.trigger.driver.as_str();
        let unknown = || OpenError::Config(format!("trigger.driver: there is no driver {driver:?}"));
        let model = TRIGGER_UNITS.iter().find(|model| model.name == driver).ok_or_else(unknown)?;
        let wire = if config.trigger.address == "sim" {
            let rig = config.rig.as_ref().ok_or_else(no_world)?;
            let (ours, theirs) = tokio::io::duplex(PIPE_BYTES);
            simulate_trigger(driver, rig, theirs, pulses, start)?;
            Wire::over(ours, "trigger unit at sim")
        } else {
            let settings = line_settings(config.trigger.baud, (model.wire_settings)());
            let wire = Wire::open(&config.trigger.address, "trigger unit", &settings).await?;
            wire.reopening(Reopening::for_s(config.trigger.reopen_s))
        };
        Ok((model.drive)(wire, config.trigger_limits()))
    }

    async fn open_plate(
        &self,
        start: tokio::time::Instant,
    ) -> Result<(Box<dyn Calibrator>, Option<Arc<Mutex<Plate>>>), OpenError> {
        let config = &self.config.plate;
        let model = ditd_drivers::calibrator(&config.driver).ok_or_else(|| {
            OpenError::Config(format!("plate.driver: there is no driver {:?}", config.driver))
        })?;
        let policy = Reopening::for_s(config.reopen_s);
        if config.address != "sim" {
            let settings = line_settings(config.baud, (model.wire_settings)());
            let wire = Wire::open(&config.address, "plate calibrator", &settings).await?;
            return Ok(((model.drive)(wire.reopening(policy)), None));
        }
        let rig = self.config.rig.as_ref().ok_or_else(no_world)?;
        let plate = Arc::new(Mutex::new(Plate::new(rig.plate.clone(), self.config.campaign.seed)));
        let opener = calibrator_socket(&config.driver, rig, &plate, start)?;
        let wire = Wire::plugged(opener, "plate calibrator at sim").await?;
        Ok(((model.drive)(wire.reopening(policy)), Some(plate)))
    }

    async fn open_camera(
        &self,
        plate: Option<Arc<Mutex<Plate>>>,
        pulses: mpsc::Receiver<Pulse>,
        start: tokio::time::Instant,
    ) -> Result<Box<dyn Camera>, OpenError> {
        let camera = &self.config.camera;
        if camera.address == SIMULATED {
            return Ok(Box::new(self.simulated_camera(plate, pulses, start)?));
        }
        open_gige(&camera.address, &camera.gige.clone().unwrap_or_default()).await
    }

    fn simulated_camera(
        &self,
        plate: Option<Arc<Mutex<Plate>>>,
        pulses: mpsc::Receiver<Pulse>,
        start: tokio::time::Instant,
    ) -> Result<SimCamera, OpenError> {
        let rig = self.config.rig.as_ref().ok_or_else(no_world)?;
        let world = match &self.world {
            Some(world) => Arc::clone(world),
            None => Arc::new(build::world(
                &RigConfig { spray: None, ..rig.clone() },
                View::Bench,
                self.config.campaign.seed,
                Path::new(""),
                &|_, _| {},
            )?),
        };
        let log = Arc::clone(&self.log);
        let state = WorldState {
            exposures: self.begins.frames,
            injections: self.begins.injections,
            ..WorldState::default()
        };
        let surface = move |now_s: f64| {
            let kelvin = match &plate {
                Some(plate) => {
                    let mut plate = plate.lock().unwrap_or_else(PoisonError::into_inner);
                    plate.advance(now_s);
                    plate.surface_k()
                }
                // A real plate in front of a simulated camera: the camera sees the room.
                None => 296.0,
            };
            log.lock().unwrap_or_else(PoisonError::into_inner).push(kelvin);
            kelvin
        };
        let camera = SimCamera::switch_on(world, Box::new(surface), rig.faults.clone(), state, pulses);
        Ok(camera.clock_from(start))
    }
}

#[cfg(feature = "aravis")]
async fn open_gige(address: &str, settings: &GigeSettings) -> Result<Box<dyn Camera>, OpenError> {
    Ok(Box::new(ditd_drivers::gige::GigeCamera::open(address, settings).await?))
}

#[cfg(not(feature = "aravis"))]
#[expect(clippy::unused_async, reason = "as the one with cameras")]
async fn open_gige(address: &str, _: &GigeSettings) -> Result<Box<dyn Camera>, OpenError> {
    Err(OpenError::Driver(DriverError::Missing {
        who: format!("camera at {address}"),
        why: ditd_drivers::gige::WITHOUT_ARAVIS.to_owned(),
        hint: "Or run the simulated camera: driver = \"sim\", address = \"sim\".".to_owned(),
    }))
}

/// The instrument's delivered line settings, with the campaign file's baud rate.
fn line_settings(baud: Option<u32>, delivered: WireSettings) -> WireSettings {
    baud.map_or(delivered, |baud| WireSettings { baud })
}

fn no_world() -> OpenError {
    OpenError::Config("address \"sim\" needs a [rig] table that describes the simulated world".to_owned())
}
