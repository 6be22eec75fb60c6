//! Finds GigE Vision cameras by asking the network who is there; needs no camera library.
//!
//! GVCP `DISCOVERY` (command 0x0002, port 3956): a device answers with the first 0xF8 bytes of its bootstrap registers. Asks,
//! and never changes anything. Big-endian throughout.

use serde::Serialize;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::Duration;
use tokio::net::UdpSocket;
use tokio::time::{Instant, timeout_at};

/// Port of the control protocol.
const PORT: u16 = 3956;

/// `DISCOVERY`, acknowledge required, from anywhere (flag 0x10: broadcast acknowledge allowed), no payload.
const QUESTION: [u8; 8] = [0x42, 0x11, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01];

/// Bytes of the registers in an answer.
const REGISTERS: usize = 0xF8;

/// Answers that are taken at most: a network has fewer cameras.
const ANSWERS_MAX: usize = 256;

/// A camera that answered.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Found {
    /// Its present address: what `[camera] address` wants.
    pub address: Ipv4Addr,
    /// Hardware address.
    pub mac: String,
    /// Maker.
    pub maker: String,
    /// Model.
    pub model: String,
    /// Version.
    pub version: String,
    /// Serial number.
    pub serial: String,
    /// Name that a user gave it.
    pub user_name: String,
}

/// Reads an answer to `DISCOVERY`.
///
/// # Errors
/// Says what is wrong with it.
pub fn read_answer(bytes: &[u8]) -> Result<Found, &'static str> {
    let half = |at: usize| bytes.get(at..at + 2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
    if half(0) != Some(0) {
        return Err("its status is not good");
    }
    if half(2) != Some(0x0003) {
        return Err("it is no answer to a discovery");
    }
    if half(4).map(usize::from) != Some(REGISTERS) || bytes.len() < 8 + REGISTERS {
        return Err("it is too short");
    }
    let registers = &bytes[8..8 + REGISTERS];
    let text = |at: usize, length: usize| {
        let field = &registers[at..at + length];
        let end = field.iter().position(|byte| *byte == 0).unwrap_or(length);
        String::from_utf8_lossy(&field[..end]).trim().to_owned()
    };
    let ip: [u8; 4] = [registers[0x24], registers[0x25], registers[0x26], registers[0x27]];
    let mac: Vec<String> = registers[0x0A..0x10].iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Found {
        address: Ipv4Addr::from(ip),
        mac: mac.join(":"),
        maker: text(0x48, 32),
        model: text(0x68, 32),
        version: text(0x88, 32),
        serial: text(0xD8, 16),
        user_name: text(0xE8, 16),
    })
}

/// Asks on each of `targets` (a camera's address, or a network's broadcast address) from the local address beside it, and
/// collects what answers within `wait`; each camera once, sorted by address. A network that cannot be asked is left out.
///
/// # Errors
/// None of the networks could be asked.
pub async fn discover(targets: &[(Ipv4Addr, Ipv4Addr)], wait: Duration) -> io::Result<Vec<Found>> {
    let mut sockets = Vec::new();
    let mut refused = None;
    for (local, target) in targets {
        match ask(*local, *target).await {
            Ok(socket) => sockets.push(socket),
            Err(error) => refused = Some(error),
        }
    }
    if let (true, Some(error)) = (sockets.is_empty(), refused) {
        return Err(error);
    }
    let until = Instant::now() + wait;
    let mut found = Vec::new();
    for socket in sockets {
        let mut bytes = [0; 1024];
        // After the time is over what has come is still read.
        while found.len() < ANSWERS_MAX
            && let Ok(Ok((count, from))) = timeout_at(until, socket.recv_from(&mut bytes)).await
        {
            if let Ok(mut camera) = read_answer(&bytes[..count]) {
                // A camera behind another subnet's address still shows where it answers from.
                if let (true, IpAddr::V4(ip)) = (camera.address.is_unspecified(), from.ip()) {
                    camera.address = ip;
                }
                found.push(camera);
            }
        }
    }
    found.sort();
    found.dedup();
    Ok(found)
}

async fn ask(local: Ipv4Addr, target: Ipv4Addr) -> io::Result<UdpSocket> {
    let socket = UdpSocket::bind(SocketAddr::from((local, 0))).await?;
    socket.set_broadcast(true)?;
    socket.send_to(&QUESTION, SocketAddr::from((target, PORT))).await?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer() -> Vec<u8> {
        let mut bytes = vec![0; 8 + REGISTERS];
        bytes[3] = 3;
        bytes[5] = 0xF8;
        bytes[8 + 0x0A..8 + 0x10].copy_from_slice(&[0, 1, 2, 3, 4, 0xab]);
        bytes[8 + 0x24..8 + 0x28].copy_from_slice(&[192, 168, 1, 20]);
        bytes[8 + 0x48..8 + 0x48 + 4].copy_from_slice(b"FLIR");
        bytes[8 + 0x68..8 + 0x68 + 5].copy_from_slice(b"A6750");
        bytes[8 + 0xD8..8 + 0xD8 + 3].copy_from_slice(b"123");
        bytes
    }

    #[test]
    fn an_answer_says_who_and_where() {
        let found = read_answer(&answer()).unwrap();
        assert_eq!(found.address, Ipv4Addr::new(192, 168, 1, 20));
        assert_eq!(found.mac, "00:01:02:03:04:ab");
        let words = (found.maker.as_str(), found.model.as_str(), found.serial.as_str());
        assert_eq!(words, ("FLIR", "A6750", "123"));
    }

    #[test]
    fn what_is_no_answer_is_none() {
        for length in 0..answer().len() {
            assert!(read_answer(&answer()[..length]).is_err(), "{length} bytes");
        }
        let mut refused = answer();
        refused[0] = 0x80;
        assert!(read_answer(&refused).is_err());
        let mut other = answer();
        other[3] = 0x81;
        assert!(read_answer(&other).is_err());
    }

    /// Real sockets on loopback: one camera that answers twice, and noise.
    #[tokio::test]
    async fn a_camera_is_found_once() {
        let address = Ipv4Addr::new(127, 0, 0, 93);
        let camera = UdpSocket::bind(SocketAddr::from((address, PORT))).await.unwrap();
        let served = tokio::spawn(async move {
            let mut question = [0; 64];
            let (count, from) = camera.recv_from(&mut question).await.unwrap();
            assert_eq!(question[..count], QUESTION);
            camera.send_to(b"noise", from).await.unwrap();
            camera.send_to(&answer(), from).await.unwrap();
            camera.send_to(&answer(), from).await.unwrap();
        });
        let found = discover(&[(Ipv4Addr::LOCALHOST, address)], Duration::from_millis(500)).await.unwrap();
        served.await.unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].model, "A6750");
    }
}
