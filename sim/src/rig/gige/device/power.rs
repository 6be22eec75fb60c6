//! Registers as they are after switching on.

use super::{Device, PACKET_DEFAULT, PENDING_MS};
use crate::rig::gige::bootstrap::*;
use crate::rig::gige::profile::encoded;

impl Device {
    /// All registers as after switching on, control with nobody. The user's name stays: it is kept in the camera.
    pub(in crate::rig::gige) fn power_on(&mut self, now_ns: u64) {
        let name = self.text(USER_NAME, USER_NAME_BYTES);
        self.bootstrap.fill(0);
        self.banks.clear();
        (self.controller, self.acquiring, self.armed) = (None, false, false);
        self.switched_on_ns = now_ns;
        for index in 0..self.features.len() {
            let initial = self.features[index].initial.clone();
            self.store(index, &initial);
        }
        for (name, value) in self.profile.initial.clone() {
            let index = self.index(&name);
            let bytes = encoded(&self.features[index].kind, value).expect("checked when the camera was made");
            self.store(index, &bytes);
        }
        self.bootstrap_defaults(&name);
        self.refresh(now_ns);
    }

    fn bootstrap_defaults(&mut self, user_name: &[u8]) {
        let identity = self.profile.identity.clone();
        let [.., high, low] = self.profile.address.octets();
        for (address, value) in [
            // GigE Vision 2.0.
            (VERSION, 0x0002_0000),
            // Big-endian, UTF-8.
            (MODE, 0x8000_0001),
            // A locally administered MAC with the end of the address in it.
            (MAC_HIGH, 0x0000_0200),
            (MAC_LOW, 0x5D17_0000 | u32::from(high) << 8 | u32::from(low)),
            (IP_CAPABILITY, 1),
            (IP_CONFIGURATION, 1),
            (IP_ADDRESS, self.profile.address.to_bits()),
            (IP_MASK, 0xFF00_0000),
            (INTERFACES, 1),
            (STREAM_CHANNELS, 1),
            // Stream source port register, 64-bit block ids.
            (GVSP_CAPABILITY, 0xC000_0000),
            // User name, serial number, heartbeat can be disabled; PENDING_ACK, resend, WRITEMEM, concatenation.
            (GVCP_CAPABILITY, 0xE000_0027),
            (HEARTBEAT_TIMEOUT, 3000),
            (TICKS_HIGH, 0),
            (TICKS_LOW, TICKS_PER_SECOND),
            (PENDING_TIMEOUT, u32::from(PENDING_MS)),
            (PACKET_SIZE, PACKET_DEFAULT),
            (STREAM_SOURCE_PORT, u32::from(self.profile.stream_port)),
        ] {
            self.set_word(address, value);
        }
        let url = format!("Local:ditd_camera.xml;{XML_BASE:X};{:X}", self.description.len());
        for (address, bytes, text) in [
            (MAKER, 32, identity.maker.as_bytes()),
            (MODEL, 32, identity.model.as_bytes()),
            (DEVICE_VERSION, 32, identity.firmware.as_bytes()),
            (MAKER_INFO, 48, b"simulated infrared camera".as_slice()),
            (SERIAL, 16, identity.serial.as_bytes()),
            (USER_NAME, USER_NAME_BYTES as usize, user_name),
            (XML_URL, 512, url.as_bytes()),
        ] {
            // The last byte stays 0 but for the serial number, whose 16 characters all count.
            let room = if address == SERIAL { bytes } else { bytes - 1 };
            let start = address as usize;
            let count = text.len().min(room);
            self.bootstrap[start..start + count].copy_from_slice(&text[..count]);
        }
    }
}
