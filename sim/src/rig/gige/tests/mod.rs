//! A small client of our own on loopback: what the camera on the network says and sends, without any library.
//!
//! Real time and real sockets, few and short; every wait has a limit that only a dead server reaches.

mod control;
mod makes;
mod stream;
mod world;

use super::gvcp::client::{answer, command};
use super::gvcp::{Command, ResendRange};
use super::gvsp::client::{LEADER, PAYLOAD, Packet, TRAILER, parse};
use super::pattern::PatternCamera;
use super::{GigeCamera, GigeFault, GigeServer, Preset, Sensor};
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::time::Duration;
use tokio::net::UdpSocket;
use tokio::sync::mpsc;
use tokio::time::{interval, timeout};

/// Patience with a loaded machine.
const LONG: Duration = Duration::from_secs(30);

/// A detector whose frame takes two packets of the smallest size with 2 × 540 bytes.
const SENSOR: Sensor = Sensor { rows: 8, columns: 64, bits: 14, shutter: true };

const SUCCESS: u16 = 0;
const CCP: u32 = 0x0A00;
const HEARTBEAT: u32 = 0x0938;
const PENDING: u16 = 0x0089;

/// A pattern camera on a free port of loopback.
async fn camera(change: impl FnOnce(GigeCamera) -> GigeCamera) -> GigeServer {
    let (pulses, taken) = mpsc::channel(64);
    let (rows, columns) = (SENSOR.rows as usize, SENSOR.columns as usize);
    let pattern = PatternCamera::new(rows, columns, SENSOR.bits, taken);
    let camera = GigeCamera::new(Box::new(pattern), SENSOR).pulses(pulses);
    change(camera).serve_at(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0)).await.expect("loopback has free ports")
}

async fn faulty(fault: GigeFault) -> GigeServer {
    camera(|camera| camera.faults(vec![fault], 7)).await
}

/// What one block brought.
#[derive(Debug, Default)]
struct Collected {
    id: u64,
    leader: Option<Vec<u8>>,
    payload: BTreeMap<u32, Vec<u8>>,
    trailer: Option<u32>,
}

impl Collected {
    fn bytes(&self) -> Vec<u8> {
        self.payload.values().flatten().copied().collect()
    }

    fn samples(&self) -> Vec<u16> {
        self.bytes().as_chunks::<2>().0.iter().map(|&sample| u16::from_le_bytes(sample)).collect()
    }

    fn timestamp(&self) -> u64 {
        let leader = self.leader.as_ref().expect("a block with its leader");
        u64::from_be_bytes(*leader[4..].first_chunk().expect("36 bytes"))
    }

    fn is_whole(&self) -> bool {
        let packets = self.trailer.unwrap_or(u32::MAX);
        self.leader.is_some() && self.payload.len() as u64 + 1 == u64::from(packets)
    }
}

struct Client {
    socket: UdpSocket,
    stream: UdpSocket,
    id: u16,
    /// PENDING_ACKs heard.
    pending: u32,
    description: String,
}

impl Client {
    async fn of(server: &GigeServer) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").await.expect("loopback has free ports");
        socket.connect(SocketAddr::V4(server.address())).await.expect("loopback connects");
        let stream = UdpSocket::bind("127.0.0.1:0").await.expect("loopback has free ports");
        Self { socket, stream, id: 0, pending: 0, description: String::new() }
    }

    /// A client that has control and a stream with the smallest packets.
    async fn in_control(server: &GigeServer) -> Self {
        let mut client = Self::of(server).await;
        assert_eq!(client.write(CCP, 2).await, SUCCESS);
        // A test that is held up does not lose control.
        assert_eq!(client.write(HEARTBEAT, 600_000).await, SUCCESS);
        let port = client.stream.local_addr().expect("bound").port();
        assert_eq!(client.write(0x0D00, u32::from(port)).await, SUCCESS);
        assert_eq!(client.write(0x0D18, Ipv4Addr::LOCALHOST.to_bits()).await, SUCCESS);
        assert_eq!(client.write(0x0D04, 576).await, SUCCESS);
        client.read_description().await;
        client
    }

    async fn read_description(&mut self) {
        let url = String::from_utf8(self.read(0x200, 512).await.expect("the first URL")).expect("ASCII");
        let url = url.trim_end_matches('\0');
        let parts: Vec<&str> = url.split(';').collect();
        let number = |text: &str| u32::from_str_radix(text, 16).expect("hexadecimal");
        let (start, length) = (number(parts[1]), number(parts[2]));
        let mut text = Vec::new();
        for at in (0..length).step_by(512) {
            text.extend(self.read(start + at, (length - at).min(512)).await.expect("the description"));
        }
        self.description = String::from_utf8(text).expect("ASCII");
    }

    /// Sends raw bytes and waits for the answer with the id.
    async fn exchange(&mut self, bytes: &[u8], id: u16) -> (u16, Vec<u8>) {
        self.socket.send(bytes).await.expect("loopback takes it");
        self.answer_to(id).await
    }

    async fn answer_to(&mut self, id: u16) -> (u16, Vec<u8>) {
        let mut buffer = [0; 1024];
        loop {
            let count =
                timeout(LONG, self.socket.recv(&mut buffer)).await.expect("an answer").expect("received");
            let (status, number, of, payload) = answer(&buffer[..count]).expect("an acknowledge");
            if of == id && number == PENDING {
                self.pending += 1;
            } else if of == id {
                return (status, payload);
            }
        }
    }

    async fn ask(&mut self, asked: &Command) -> (u16, Vec<u8>) {
        self.id += 1;
        let bytes = command(asked, self.id);
        self.exchange(&bytes, self.id).await
    }

    async fn write(&mut self, address: u32, value: u32) -> u16 {
        self.ask(&Command::WriteRegister(vec![(address, value)])).await.0
    }

    async fn read(&mut self, address: u32, count: u32) -> Result<Vec<u8>, u16> {
        let count = u16::try_from(count).expect("small");
        let (status, payload) = self.ask(&Command::ReadMemory { address, count }).await;
        if status == SUCCESS { Ok(payload[4..].to_vec()) } else { Err(status) }
    }

    async fn word(&mut self, address: u32) -> u32 {
        let bytes = self.read(address, 4).await.expect("readable");
        u32::from_be_bytes(*bytes.first_chunk().expect("four bytes"))
    }

    /// Address of a feature's register, from the description.
    fn address(&self, feature: &str) -> u32 {
        let node = format!("Reg Name=\"{feature}Reg\"");
        let (_, rest) = self.description.split_once(&node).unwrap_or_else(|| panic!("no {feature}"));
        let (_, rest) = rest.split_once("<Address>0x").expect("every register has an address");
        u32::from_str_radix(rest.split('<').next().expect("text"), 16).expect("hexadecimal")
    }

    async fn get(&mut self, feature: &str) -> u32 {
        self.word(self.address(feature)).await
    }

    async fn set(&mut self, feature: &str, value: u32) -> u16 {
        self.write(self.address(feature), value).await
    }

    async fn set_double(&mut self, feature: &str, value: f64) -> u16 {
        let address = self.address(feature);
        self.ask(&Command::WriteMemory { address, bytes: value.to_be_bytes().to_vec() }).await.0
    }

    async fn get_double(&mut self, feature: &str) -> f64 {
        let bytes = self.read(self.address(feature), 8).await.expect("readable");
        f64::from_be_bytes(*bytes.first_chunk().expect("eight bytes"))
    }

    /// Starts a stream whose frames are triggered by command.
    async fn start_software(&mut self) {
        assert_eq!(self.set("TriggerMode", 1).await, SUCCESS);
        assert_eq!(self.set("TriggerSource", 0).await, SUCCESS);
        assert_eq!(self.set("AcquisitionStart", 1).await, SUCCESS);
    }

    async fn trigger(&mut self) {
        assert_eq!(self.set("TriggerSoftware", 1).await, SUCCESS);
    }

    async fn packet(&mut self) -> Packet {
        let mut buffer = [0; 2048];
        let count = timeout(LONG, self.stream.recv(&mut buffer)).await.expect("a packet").expect("received");
        parse(&buffer[..count]).expect("a stream packet")
    }

    /// The packets up to and with the next trailer.
    async fn block(&mut self) -> Collected {
        let mut block = Collected::default();
        loop {
            let packet = self.packet().await;
            assert_eq!(packet.status, 0, "{packet:?}");
            block.id = packet.block;
            match packet.format {
                LEADER => block.leader = Some(packet.content),
                PAYLOAD => {
                    block.payload.insert(packet.packet, packet.content);
                }
                TRAILER => {
                    block.trailer = Some(packet.packet);
                    return block;
                }
                other => panic!("format {other}"),
            }
        }
    }

    /// One triggered frame.
    async fn shot(&mut self) -> Collected {
        self.trigger().await;
        self.block().await
    }

    /// Asks for packets again; nothing is acknowledged.
    async fn resend(&mut self, range: ResendRange) {
        self.id += 1;
        let bytes = command(&Command::PacketResend { channel: 0, range }, self.id);
        self.stream_send(&bytes).await;
    }

    async fn stream_send(&mut self, bytes: &[u8]) {
        let to = self.socket.peer_addr().expect("connected");
        self.stream.send_to(bytes, to).await.expect("loopback takes it");
    }
}

/// Waits until something that the server does by itself has happened.
async fn until(what: &str, mut happened: impl FnMut() -> bool) {
    let mut every = interval(Duration::from_millis(5));
    let waiting = async {
        while !happened() {
            every.tick().await;
        }
    };
    timeout(LONG, waiting).await.unwrap_or_else(|_| panic!("{what} does not happen"));
}
