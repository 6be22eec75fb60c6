//! Who may write, what a write does, and what it is limited to.

use super::*;
use crate::rig::gige::plan::Trigger;
use crate::rig::gige::presets::{Preset, Sensor};
use ditd_drivers::instrument::Identity;
use std::net::Ipv4Addr;

const OWNER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 5000);
const SECOND: u64 = 1_000_000_000;

fn device(preset: Preset) -> Device {
    let text = |text: &str| text.to_owned();
    let identity = Identity {
        maker: text("m"),
        model: text("a model with a name of more than 31 letters"),
        serial: text("s"),
        firmware: text("f"),
    };
    let profile = Profile {
        preset,
        sensor: Sensor { rows: 512, columns: 640, bits: 14, shutter: false },
        identity,
        address: Ipv4Addr::new(127, 0, 0, 9),
        stream_port: 4000,
        cool_down_ns: SECOND,
        initial: vec![("AcquisitionMode".to_owned(), 1.0)],
    };
    profile.check().expect("possible");
    let mut device = Device::new(profile, 0);
    device.write(OWNER, CONTROL, &[0, 0, 0, 2], 0).expect("nobody has control");
    device
}

fn set(device: &mut Device, feature: &str, bytes: &[u8]) -> Result<Option<Effect>, Status> {
    let address = device.address_of(feature).expect("the feature is there");
    device.write(OWNER, address, bytes, 2 * SECOND)
}

#[test]
fn doubles_may_come_in_halves() {
    let mut device = device(Preset::Generic);
    let address = device.address_of("ExposureTime").unwrap();
    let bytes = 25.0_f64.to_be_bytes();
    // 1000.0 with the upper half of 25.0 is 25.0 already: its lower half is zero, as that of 1000.0.
    device.write(OWNER, address, &bytes[..4], 0).unwrap();
    device.write(OWNER, address + 4, &bytes[4..], 0).unwrap();
    assert!((device.plan().settings.integration_s - 25e-6).abs() < 1e-15);
    // A half that makes nonsense is refused and changes nothing.
    assert_eq!(device.write(OWNER, address, &[0xFF; 4], 0), Err(Status::InvalidParameter));
    assert!((device.plan().settings.integration_s - 25e-6).abs() < 1e-15);
}

#[test]
fn regions_never_leave_the_detector() {
    let mut device = device(Preset::Telops);
    let put = |device: &mut Device, name: &str, value: u32| set(device, name, &value.to_be_bytes());
    assert_eq!(put(&mut device, "OffsetY", 1), Err(Status::InvalidParameter));
    put(&mut device, "Height", 102).unwrap();
    put(&mut device, "OffsetY", 412).unwrap();
    assert_eq!(put(&mut device, "Height", 103), Err(Status::InvalidParameter));
    assert_eq!(put(&mut device, "Height", 2), Err(Status::InvalidParameter));
    assert_eq!(put(&mut device, "Width", 60), Err(Status::InvalidParameter));
    let layout = device.plan().layout;
    assert_eq!((layout.rows, layout.header_rows, layout.offset_y), (100, 2, 412));
}

#[test]
fn what_lies_behind_a_selector_stays_apart() {
    let mut device = device(Preset::Telops);
    let mut put = |name: &str, value: u32| set(&mut device, name, &value.to_be_bytes()).unwrap();
    put("TriggerSelector", 2);
    put("TriggerMode", 1);
    put("TriggerSource", 48);
    put("TriggerSelector", 0);
    assert_eq!(device.trigger(), Trigger::Free);
    let mut put = |name: &str, value: u32| set(&mut device, name, &value.to_be_bytes()).unwrap();
    put("TriggerMode", 1);
    put("TriggerSelector", 1);
    assert_eq!(device.trigger(), Trigger::Software);
    set(&mut device, "TriggerSelector", &[0; 4]).unwrap();
    set(&mut device, "TriggerSource", &48_u32.to_be_bytes()).unwrap();
    assert_eq!(device.trigger(), Trigger::External);
}

#[test]
fn locked_while_the_stream_runs_and_cold_before_it_does() {
    let mut device = device(Preset::Generic);
    let start = device.address_of("AcquisitionStart").unwrap();
    let one = [0, 0, 0, 1];
    assert_eq!(device.write(OWNER, start, &one, SECOND / 2), Err(Status::Busy));
    assert_eq!(device.write(OWNER, start, &one, SECOND), Ok(Some(Effect::Start)));
    device.set_acquiring(true, SECOND);
    assert_eq!(device.write(OWNER, start, &one, SECOND), Ok(None));
    assert_eq!(set(&mut device, "Width", &[0, 0, 1, 0]), Err(Status::Busy));
    assert_eq!(device.write(OWNER, PACKET_SIZE, &[0, 0, 5, 0], SECOND), Err(Status::Busy));
    // Closing the stream's port stops it.
    assert_eq!(device.write(OWNER, STREAM_PORT, &[0; 4], SECOND), Ok(Some(Effect::Stop)));
    // The clock's reset does not warm the camera up.
    device.set_acquiring(false, SECOND);
    assert_eq!(device.write(OWNER, TIMESTAMP_CONTROL, &[0, 0, 0, 1], SECOND), Ok(Some(Effect::ClockReset)));
    assert_eq!(device.write(OWNER, start, &one, 0), Ok(Some(Effect::Start)));
}

#[test]
fn names_are_cut_and_initial_values_kept_over_a_restart() {
    let mut device = device(Preset::Flir);
    assert_eq!(&device.discovery()[0x68..0x88], b"a model with a name of more tha\0");
    assert_eq!(device.plan().frames_max, Some(1));
    set(&mut device, "AcquisitionMode", &[0; 4]).unwrap();
    assert_eq!(device.plan().frames_max, None);
    device.power_on(5 * SECOND);
    assert_eq!((device.plan().frames_max, device.controller()), (Some(1), None));
}

/// No address and no length makes it panic, whoever asks.
#[test]
fn every_address_can_be_asked_for() {
    let mut device = device(Preset::Generic);
    let addresses = (0..0x1100).chain(0x0001_0000..0x0001_0400).chain(0x0010_0000..0x0010_0040);
    for address in addresses.chain([0x7FFF_FFFC, u32::MAX - 3, u32::MAX]) {
        for count in [0, 1, 4, 8, 536] {
            let read = device.read(OWNER, address, count, SECOND);
            assert!(read.is_err() || read.is_ok_and(|bytes| bytes.len() == count as usize));
        }
        for bytes in [&[][..], &[0; 4], &[0xFF; 4], &[0xFF; 8], &[0; 536]] {
            if address != CONTROL {
                let _ = device.write(OWNER, address, bytes, SECOND);
            }
        }
    }
}
