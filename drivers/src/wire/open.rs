//! Opens an address, and says in words why it cannot be opened or why it has ended.

use super::{ByteStream, Reopening, Wire};
use crate::error::DriverError;
use serde::{Deserialize, Serialize};
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::time::Duration;
use tokio::time::timeout;
use tokio_serial::SerialPortBuilderExt;

/// How long a TCP connection may take to open.
const CONNECT_DEADLINE: Duration = Duration::from_secs(5);

/// What is set when a line is opened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WireSettings {
    /// Bits per second of a serial line (8 data bits, no parity, 1 stop bit); without meaning on TCP.
    pub baud: u32,
}

/// One try of opening a line.
pub type Opening = Pin<Box<dyn Future<Output = Result<Box<dyn ByteStream>, DriverError>> + Send>>;

/// Opens a line, as often as it is asked to.
pub type Opener = Box<dyn FnMut() -> Opening + Send>;

impl Wire {
    /// Opens `serial:/dev/…` or `tcp:host:port`. `role` is the instrument's part in the rig, for messages. When the line
    /// goes it is opened again as usual ([`Reopening::usual`]).
    ///
    /// # Errors
    /// [`DriverError::Missing`] when the address is malformed, or the device is absent, busy or not permitted.
    pub async fn open(address: &str, role: &str, settings: &WireSettings) -> Result<Self, DriverError> {
        let who = format!("{role} at {address}");
        let (own_address, own_who, baud) = (address.to_owned(), who.clone(), settings.baud);
        let opener: Opener = Box::new(move || {
            let (address, who) = (own_address.clone(), own_who.clone());
            Box::pin(async move { open_stream(&address, &who, baud).await })
        });
        let mut wire = Self::plugged(opener, who).await?;
        wire.baud = address.starts_with("serial:").then_some(baud);
        Ok(wire)
    }

    /// A wire over what `opener` opens, now and whenever the line has gone. `name` as for [`Wire::over`].
    ///
    /// # Errors
    /// Those of the opener.
    pub async fn plugged(mut opener: Opener, name: impl Into<String>) -> Result<Self, DriverError> {
        let stream = opener().await?;
        let wire = Self::over(stream, name);
        Ok(Self { opener: Some(opener), reopening: Reopening::usual(), ..wire })
    }
}

async fn open_stream(address: &str, who: &str, baud: u32) -> Result<Box<dyn ByteStream>, DriverError> {
    let missing =
        |why: String, hint: &str| DriverError::Missing { who: who.to_owned(), why, hint: hint.to_owned() };
    match address.split_once(':') {
        Some(("serial", path)) => match tokio_serial::new(path, baud).open_native_async() {
            Ok(port) => Ok(Box::new(port)),
            Err(error) => Err(missing(error.to_string(), serial_hint(&error.to_string()))),
        },
        Some(("tcp", peer)) => match timeout(CONNECT_DEADLINE, tokio::net::TcpStream::connect(peer)).await {
            Ok(Ok(stream)) => {
                // Questions are short and wait for their answers: nothing is gained by collecting them.
                let _ = stream.set_nodelay(true);
                Ok(Box::new(stream))
            }
            Ok(Err(error)) => Err(missing(error.to_string(), tcp_hint(&error))),
            Err(_) => Err(missing(
                format!("no connection in {} s", CONNECT_DEADLINE.as_secs()),
                "Check the host name, the route and any firewall between here and the instrument.",
            )),
        },
        _ => Err(missing(
            "the address names no kind of line".to_owned(),
            "Write serial:/dev/serial/by-id/… or tcp:host:port.",
        )),
    }
}

/// What to try when a serial port does not open. The serial library gives absent, busy and forbidden ports one kind
/// of error; only its text tells them apart.
pub(super) fn serial_hint(why: &str) -> &'static str {
    let why = why.to_lowercase();
    if why.contains("permission") || why.contains("denied") {
        "Add the user to the group that owns the port (often dialout), then log in again."
    } else if why.contains("lock") || why.contains("busy") {
        "Another program holds the port: stop it (a second daemon, a terminal program, a modem manager)."
    } else if why.contains("not a typewriter") || why.contains("inappropriate ioctl") {
        "This is no serial port: name the device of the adapter, for instance /dev/serial/by-id/…."
    } else if why.contains("input/output") || why.contains("i/o error") {
        "The device is there but does not work: unplug the adapter, plug it in again, and look at the kernel's log."
    } else {
        "Check the cable, and name the port by /dev/serial/by-id/…: USB adapters change their numbers."
    }
}

fn tcp_hint(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::ConnectionRefused => {
            "The host is there, but nothing listens on this port: check the port, and that no other program holds the \
             instrument's only connection."
        }
        io::ErrorKind::InvalidInput => "Write tcp:host:port.",
        _ => "Check that the instrument is on, the network cable plugged, and host and port right.",
    }
}

/// What to try when an open line has ended, by an error of the system or, without one, by its end.
pub(super) fn loss_hint(error: Option<&io::Error>) -> &'static str {
    match error.map(io::Error::kind) {
        Some(io::ErrorKind::ConnectionReset | io::ErrorKind::BrokenPipe | io::ErrorKind::TimedOut) => {
            "The instrument or its converter ended the connection: check its power and that only one program uses it."
        }
        Some(io::ErrorKind::PermissionDenied) => {
            "The port was taken away: look for another program that uses it."
        }
        // End of file, EIO, ENXIO, ENODEV: what an unplugged adapter gives.
        _ => "Plug it in again and check its power.",
    }
}

/// True when an error of a pseudo-terminal's master side means that nobody has the other side open.
pub fn is_nobody_there(error: &io::Error) -> bool {
    // EIO, Linux and macOS alike.
    error.raw_os_error() == Some(5)
}
