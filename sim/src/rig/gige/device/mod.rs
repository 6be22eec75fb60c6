//! The camera's registers and what they mean: who may write, what a write does, what it is limited to.
//!
//! Pure: time is handed in, effects are handed out and carried out elsewhere.

mod power;
mod store;

#[cfg(test)]
mod tests;

use super::bootstrap::*;
use super::feature::{Access, FEATURES_BASE, Feature, Kind, word};
use super::gvcp::Status;
use super::gvsp::IdMode;
use super::profile::Profile;
use super::xml;
use std::collections::BTreeMap;
use std::net::SocketAddrV4;

const FIRE_TEST_PACKET: u32 = 1 << 31;
const DO_NOT_FRAGMENT: u32 = 1 << 30;

/// Packet size after switching on, in bytes.
const PACKET_DEFAULT: u32 = 1500 | DO_NOT_FRAGMENT;

/// Packet sizes taken, in bytes, and their grain: the least that every IP host takes, and a jumbo frame.
const PACKET_SIZES: [u32; 2] = [576, 9000];
const PACKET_SIZE_GRAIN: u32 = 4;

/// Shortest heartbeat timeout, in milliseconds (the standard's).
const HEARTBEAT_MS_MIN: u32 = 500;

/// Longest that an act takes, in milliseconds: what PENDING_ACK and its register say.
pub(super) const PENDING_MS: u16 = 2000;

/// 77 K and a warm laboratory, in degrees Celsius: the detector when cold and when just switched on.
const COLD_C: f64 = -196.15;
const WARM_C: f64 = 20.0;

/// What has to happen after a write.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Effect {
    /// Prepare, start, stream.
    Start,
    /// Stop streaming.
    Stop,
    /// One software trigger.
    Trigger,
    /// Move the shutter.
    Shutter(bool),
    /// Non-uniformity correction.
    Correct,
    /// Restart.
    Reset,
    /// Control was given back.
    Released,
    /// Send a test packet of this size, in bytes.
    TestPacket(usize),
    /// Somebody has overwritten the factory gain.
    Spoil,
    /// The clock is put to 0.
    ClockReset,
}

/// The registers.
#[derive(Debug)]
pub(super) struct Device {
    profile: Profile,
    features: Vec<Feature>,
    bootstrap: Vec<u8>,
    memory: Vec<u8>,
    description: Vec<u8>,
    /// Values behind a selector: feature, selector value.
    banks: BTreeMap<(usize, u32), Vec<u8>>,
    controller: Option<SocketAddrV4>,
    acquiring: bool,
    armed: bool,
    switched_on_ns: u64,
}

impl Device {
    /// A camera just switched on, at `now_ns` of its clock. The profile has been checked.
    pub(super) fn new(profile: Profile, now_ns: u64) -> Self {
        let features = profile.preset.features(profile.sensor);
        let identity = &profile.identity;
        let mut description = xml::description(&identity.maker, &identity.model, &features).into_bytes();
        // Clients read whole words.
        description.resize(description.len().next_multiple_of(4), b'\n');
        let last = features.last().expect("every make has features");
        let memory = vec![0; (last.address + last.kind.bytes() - FEATURES_BASE) as usize];
        let mut device = Self {
            features,
            bootstrap: vec![0; BOOTSTRAP_BYTES as usize],
            memory,
            description,
            banks: BTreeMap::new(),
            controller: None,
            acquiring: false,
            armed: false,
            switched_on_ns: now_ns,
            profile,
        };
        device.power_on(now_ns);
        device
    }

    /// Make, detector and names.
    pub(super) fn profile(&self) -> &Profile {
        &self.profile
    }

    /// Who has control.
    pub(super) fn controller(&self) -> Option<SocketAddrV4> {
        self.controller
    }

    /// Whether the stream runs.
    pub(super) fn acquiring(&self) -> bool {
        self.acquiring
    }

    /// Heartbeat timeout in milliseconds; `None` when it is disabled.
    pub(super) fn heartbeat_ms(&self) -> Option<u32> {
        (self.word(GVCP_CONFIGURATION) & 1 == 0).then(|| self.word(HEARTBEAT_TIMEOUT))
    }

    /// How blocks are numbered.
    pub(super) fn ids(&self) -> IdMode {
        let extended = self.word(GVSP_CONFIGURATION) & (1 << 30) != 0;
        if extended { IdMode::Extended } else { IdMode::Standard }
    }

    /// Takes control from whoever has it: the stream's port is closed.
    pub(super) fn release(&mut self) {
        self.controller = None;
        for address in [CONTROL, STREAM_PORT, PRIMARY_PORT, PRIMARY_ADDRESS] {
            self.set_word(address, 0);
        }
    }

    /// Notes that the stream has been started or has ended.
    pub(super) fn set_acquiring(&mut self, acquiring: bool, now_ns: u64) {
        self.acquiring = acquiring;
        self.armed = acquiring;
        self.refresh(now_ns);
    }

    /// Puts the integration time that the camera really took into its register.
    pub(super) fn set_integration(&mut self, integration_s: f64) {
        let (name, per_second) = self.profile.preset.exposure();
        let index = self.index(name);
        self.store(index, &(integration_s * per_second).to_be_bytes());
    }

    /// Notes the temperature of the closed shutter, in degrees Celsius.
    pub(super) fn set_shutter(&mut self, closed: bool, celsius: Option<f64>) {
        if let Some(index) = self.find(self.profile.preset.shutter()) {
            self.store(index, &u32::from(closed).to_be_bytes());
        }
        if let (Some(index), Some(celsius)) = (self.find("ShutterTemperature"), celsius) {
            self.store(index, &celsius.to_be_bytes());
        }
    }

    /// Reads memory for a client.
    ///
    /// # Errors
    /// Bad alignment, no such memory, or another client's exclusive control.
    pub(super) fn read(
        &mut self,
        client: SocketAddrV4,
        address: u32,
        count: u32,
        now_ns: u64,
    ) -> Result<Vec<u8>, Status> {
        if !address.is_multiple_of(4) || !count.is_multiple_of(4) {
            return Err(Status::BadAlignment);
        }
        let exclusive = self.word(CONTROL) & EXCLUSIVE != 0;
        if exclusive && self.controller.is_some_and(|owner| owner != client) {
            return Err(Status::AccessDenied);
        }
        self.refresh(now_ns);
        self.bytes(address, count).map(<[u8]>::to_vec).ok_or(Status::InvalidAddress)
    }

    /// The first bytes of memory, as DISCOVERY answers: to anybody.
    pub(super) fn discovery(&self) -> &[u8] {
        &self.bootstrap[..usize::from(DISCOVERY_BYTES)]
    }

    fn bytes(&self, address: u32, count: u32) -> Option<&[u8]> {
        for (base, memory) in
            [(0, &self.bootstrap), (FEATURES_BASE, &self.memory), (XML_BASE, &self.description)]
        {
            if let Some(start) = address.checked_sub(base)
                && (start as usize) < memory.len()
            {
                let start = start as usize;
                return memory.get(start..start.checked_add(count as usize)?);
            }
        }
        None
    }

    /// Writes one register, or a stretch of one, for a client.
    ///
    /// # Errors
    /// The status that the acknowledge carries; nothing was changed then.
    pub(super) fn write(
        &mut self,
        client: SocketAddrV4,
        address: u32,
        bytes: &[u8],
        now_ns: u64,
    ) -> Result<Option<Effect>, Status> {
        if !address.is_multiple_of(4) || !bytes.len().is_multiple_of(4) || bytes.is_empty() {
            return Err(Status::BadAlignment);
        }
        if address == CONTROL && bytes.len() == 4 {
            return self.take_control(client, word(bytes));
        }
        let count = u32::try_from(bytes.len()).map_err(|_| Status::InvalidParameter)?;
        if self.bytes(address, count).is_none() {
            return Err(Status::InvalidAddress);
        }
        if self.controller != Some(client) {
            return Err(Status::AccessDenied);
        }
        let effect = if address < BOOTSTRAP_BYTES {
            self.write_bootstrap(address, bytes, now_ns)
        } else {
            self.write_feature(address, bytes, now_ns)
        }?;
        self.refresh(now_ns);
        Ok(effect)
    }

    fn take_control(&mut self, client: SocketAddrV4, wanted: u32) -> Result<Option<Effect>, Status> {
        if self.controller.is_some_and(|owner| owner != client) {
            return Err(Status::AccessDenied);
        }
        // Other bits (switch-over) are not served.
        if wanted & !(EXCLUSIVE | CONTROLLING) != 0 {
            return Err(Status::InvalidParameter);
        }
        if wanted == 0 {
            let had = self.controller.is_some();
            self.release();
            return Ok(had.then_some(Effect::Released));
        }
        self.controller = Some(client);
        self.set_word(CONTROL, wanted);
        self.set_word(PRIMARY_PORT, u32::from(client.port()));
        self.set_word(PRIMARY_ADDRESS, client.ip().to_bits());
        Ok(None)
    }

    fn write_bootstrap(&mut self, address: u32, bytes: &[u8], now_ns: u64) -> Result<Option<Effect>, Status> {
        if (USER_NAME..USER_NAME + USER_NAME_BYTES).contains(&address) {
            let start = address as usize;
            let end = start + bytes.len();
            if end > (USER_NAME + USER_NAME_BYTES) as usize {
                return Err(Status::WriteProtect);
            }
            self.bootstrap[start..end].copy_from_slice(bytes);
            return Ok(None);
        }
        if bytes.len() != 4 {
            // Registers are written one by one; what they do would depend on the order.
            return Err(Status::InvalidParameter);
        }
        let value = word(bytes);
        let in_use = |acquiring: bool| if acquiring { Err(Status::Busy) } else { Ok(()) };
        match address {
            HEARTBEAT_TIMEOUT => self.set_word(address, value.max(HEARTBEAT_MS_MIN)),
            GVCP_CONFIGURATION => self.set_word(address, value & 1),
            GVSP_CONFIGURATION => {
                in_use(self.acquiring)?;
                self.set_word(address, value & (1 << 30));
            }
            TIMESTAMP_CONTROL => return Ok(self.control_clock(value, now_ns)),
            STREAM_PORT => {
                self.set_word(address, value & 0xFFFF);
                if value & 0xFFFF == 0 && self.acquiring {
                    return Ok(Some(Effect::Stop));
                }
            }
            // Its options (multi-part and others) are not served: whatever a client writes, they stay off.
            STREAM_CONFIGURATION => {}
            STREAM_ADDRESS => self.set_word(address, value),
            PACKET_DELAY => {
                in_use(self.acquiring)?;
                self.set_word(address, value);
            }
            PACKET_SIZE => {
                in_use(self.acquiring)?;
                let [least, most] = PACKET_SIZES;
                let size = (value & 0xFFFF).clamp(least, most) / PACKET_SIZE_GRAIN * PACKET_SIZE_GRAIN;
                self.set_word(address, size | value & DO_NOT_FRAGMENT);
                if value & FIRE_TEST_PACKET != 0 {
                    return Ok(Some(Effect::TestPacket(size as usize)));
                }
            }
            _ => return Err(Status::WriteProtect),
        }
        Ok(None)
    }

    fn control_clock(&mut self, value: u32, now_ns: u64) -> Option<Effect> {
        // Bit 0 resets, bit 1 latches.
        if value & 1 != 0 {
            self.switched_on_ns = self.switched_on_ns.wrapping_sub(now_ns);
        }
        let now_ns = if value & 1 != 0 { 0 } else { now_ns };
        if value & 2 != 0 {
            let [h, i, j, k, l, m, n, o] = now_ns.to_be_bytes();
            self.set_word(TIMESTAMP_HIGH, u32::from_be_bytes([h, i, j, k]));
            self.set_word(TIMESTAMP_LOW, u32::from_be_bytes([l, m, n, o]));
        }
        (value & 1 != 0).then_some(Effect::ClockReset)
    }

    fn write_feature(&mut self, address: u32, bytes: &[u8], now_ns: u64) -> Result<Option<Effect>, Status> {
        let end = address as usize + bytes.len();
        let fits = |f: &Feature| address >= f.address && end <= (f.address + f.kind.bytes()) as usize;
        let index = self.features.iter().position(fits).ok_or(Status::WriteProtect)?;
        let feature = &self.features[index];
        match feature.access {
            Access::ReadOnly => return Err(Status::WriteProtect),
            Access::Locked if self.acquiring => return Err(Status::Busy),
            _ => {}
        }
        let mut whole = self.value(index).to_vec();
        let start = (address - feature.address) as usize;
        whole[start..start + bytes.len()].copy_from_slice(bytes);
        let accepted = feature.kind.accept(&whole, |name| i64::from(self.integer(name)))?;
        let (name, command) = (feature.name, feature.kind == Kind::Command);
        if command {
            return self.act(name, now_ns);
        }
        if name == self.profile.preset.shutter() {
            return Ok(Some(Effect::Shutter(word(&accepted) == 1)));
        }
        self.store(index, &accepted);
        Ok(None)
    }

    fn act(&mut self, name: &str, now_ns: u64) -> Result<Option<Effect>, Status> {
        Ok(Some(match name {
            "AcquisitionStart" if self.acquiring => return Ok(None),
            "AcquisitionStart" if !self.ready(now_ns) => return Err(Status::Busy),
            "AcquisitionStart" => Effect::Start,
            "AcquisitionStop" => Effect::Stop,
            "AcquisitionArm" => {
                if !self.ready(now_ns) {
                    return Err(Status::Busy);
                }
                self.armed = true;
                return Ok(None);
            }
            "TriggerSoftware" | "SyncSoftware" => Effect::Trigger,
            "NUCExecute" | "ImageCorrection" => Effect::Correct,
            "CorrectionPerform" => Effect::Spoil,
            "DeviceReset" => Effect::Reset,
            other => unreachable!("the table has the command {other}, and nothing is written for it"),
        }))
    }

    fn ready(&self, now_ns: u64) -> bool {
        now_ns.wrapping_sub(self.switched_on_ns) >= self.profile.cool_down_ns
    }

    /// Brings up to date what follows from other registers and from time.
    fn refresh(&mut self, now_ns: u64) {
        let sensor = self.profile.sensor;
        let rows_max = sensor.rows + self.profile.preset.header_rows();
        let [width, height, x, y] = ["Width", "Height", "OffsetX", "OffsetY"].map(|name| self.integer(name));
        let payload = width * height * 2 + self.chunks().map_or(0, |chunks| chunks.bytes());
        for (name, value) in [
            ("WidthRoom", sensor.columns - x),
            ("HeightRoom", rows_max - y),
            ("OffsetXRoom", sensor.columns - width),
            ("OffsetYRoom", rows_max - height),
            ("PayloadSize", payload),
            ("AcquisitionLock", u32::from(self.acquiring)),
        ] {
            let index = self.index(name);
            self.store(index, &value.to_be_bytes());
        }
        let ready = self.ready(now_ns);
        let index = self.index("DeviceTemperature");
        let part = if ready {
            1.0
        } else {
            now_ns.wrapping_sub(self.switched_on_ns) as f64 / self.profile.cool_down_ns as f64
        };
        self.store(index, &(WARM_C + part * (COLD_C - WARM_C)).to_be_bytes());
        if let Some(index) = self.find("TDCStatus") {
            let waiting = u32::from(!ready) * 0b11;
            let arm = u32::from(!self.armed && !self.acquiring) << 8;
            let started = u32::from(self.acquiring) << 10;
            self.store(index, &(waiting | arm | started).to_be_bytes());
            let index = self.index("DeviceNotReady");
            self.store(index, &u32::from(!ready).to_be_bytes());
        }
    }
}
