//! The serial ports of this machine, and the names under which they can be configured.

use serde::Serialize;
use std::path::{Path, PathBuf};
use tokio_serial::SerialPortType;

/// A serial port.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Port {
    /// Device file.
    pub path: String,
    /// A name that stays when adapters are plugged in another order; what a campaign file should use.
    pub stable_path: Option<String>,
    /// What it is: `usb`, `pci`, `bluetooth` or `unknown`.
    pub bus: &'static str,
    /// Maker of a USB adapter.
    pub maker: Option<String>,
    /// Product name of a USB adapter.
    pub product: Option<String>,
    /// Serial number of a USB adapter.
    pub serial: Option<String>,
    /// USB vendor and product id, as `lsusb` prints them.
    pub usb_id: Option<String>,
}

/// All serial ports, sorted by path. Opens none.
///
/// # Errors
/// The system's words.
pub fn serial_ports() -> Result<Vec<Port>, String> {
    let mut ports: Vec<Port> = tokio_serial::available_ports()
        .map_err(|error| error.to_string())?
        .into_iter()
        .map(|found| describe(found.port_name, found.port_type, Path::new("/dev/serial/by-id")))
        .collect();
    ports.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(ports)
}

fn describe(path: String, kind: SerialPortType, by_id: &Path) -> Port {
    let stable_path = stable_name(Path::new(&path), by_id).map(|name| name.display().to_string());
    let (bus, usb) = match kind {
        SerialPortType::UsbPort(usb) => ("usb", Some(usb)),
        SerialPortType::PciPort => ("pci", None),
        SerialPortType::BluetoothPort => ("bluetooth", None),
        SerialPortType::Unknown => ("unknown", None),
    };
    let usb_id = usb.as_ref().map(|usb| format!("{:04x}:{:04x}", usb.vid, usb.pid));
    let (maker, product, serial) =
        usb.map(|usb| (usb.manufacturer, usb.product, usb.serial_number)).unwrap_or_default();
    Port { path, stable_path, bus, maker, product, serial, usb_id }
}

/// The link in `by_id` that leads to a device file.
fn stable_name(path: &Path, by_id: &Path) -> Option<PathBuf> {
    let target = path.canonicalize().ok()?;
    let mut names: Vec<PathBuf> =
        std::fs::read_dir(by_id).ok()?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    names.sort();
    names.into_iter().find(|name| name.canonicalize().ok().as_ref() == Some(&target))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio_serial::UsbPortInfo;

    #[test]
    fn a_usb_adapter_is_named_by_its_id() {
        let folder = std::env::temp_dir().join(format!("ditd-ports-{}", std::process::id()));
        let by_id = folder.join("by-id");
        std::fs::create_dir_all(&by_id).unwrap();
        let device = folder.join("ttyUSB7");
        std::fs::write(&device, b"").unwrap();
        let link = by_id.join("usb-FTDI_A1-if00");
        let _ = std::fs::remove_file(&link);
        std::os::unix::fs::symlink(&device, &link).unwrap();
        let usb = UsbPortInfo {
            vid: 0x0403,
            pid: 0x6001,
            serial_number: Some("A1".to_owned()),
            manufacturer: Some("FTDI".to_owned()),
            product: Some("FT232R".to_owned()),
        };
        let port = describe(device.display().to_string(), SerialPortType::UsbPort(usb), &by_id);
        assert_eq!(port.stable_path, Some(link.display().to_string()));
        assert_eq!(port.usb_id.as_deref(), Some("0403:6001"));
        assert_eq!((port.bus, port.maker.as_deref()), ("usb", Some("FTDI")));
        let bare = describe("/dev/no-such-port".to_owned(), SerialPortType::Unknown, &by_id);
        assert_eq!((bare.bus, bare.stable_path), ("unknown", None));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
