//! The control protocol's messages (GVCP): bytes to commands, acknowledges to bytes, and back for a client.
//!
//! Pure: knows no register and no socket. All numbers on the wire are big-endian. Command and status numbers are
//! those of the GigE Vision standard as the public headers of Aravis 0.8.26 and Wireshark's dissector give them.

/// UDP port of the control channel.
pub(super) const PORT: u16 = 3956;

/// First byte of every command.
const KEY: u8 = 0x42;

/// Bytes of a header.
pub(super) const HEADER_BYTES: usize = 8;

/// Largest payload of a control message: the standard keeps every message within 576 bytes of IP.
pub(super) const PAYLOAD_BYTES_MAX: usize = 540;

/// Most bytes of memory in one READMEM or WRITEMEM.
pub(super) const MEMORY_BYTES_MAX: usize = PAYLOAD_BYTES_MAX - 4;

/// What an acknowledge says about its command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Status {
    /// Done.
    Success,
    /// The command is not known.
    NotImplemented,
    /// A value that the register does not take, or a malformed payload.
    InvalidParameter,
    /// No register there.
    InvalidAddress,
    /// The register is read-only.
    WriteProtect,
    /// Address or length is not a multiple of four.
    BadAlignment,
    /// Another application has control, or nobody has.
    AccessDenied,
    /// Not now: an act is under way, or the stream runs.
    Busy,
    /// A packet that is no longer in memory (on the stream channel only).
    PacketUnavailable,
    /// The length field does not fit the datagram.
    InvalidHeader,
    /// The act was tried and failed.
    Error,
}

impl Status {
    /// The number on the wire.
    pub(super) fn code(self) -> u16 {
        match self {
            Self::Success => 0,
            Self::NotImplemented => 0x8001,
            Self::InvalidParameter => 0x8002,
            Self::InvalidAddress => 0x8003,
            Self::WriteProtect => 0x8004,
            Self::BadAlignment => 0x8005,
            Self::AccessDenied => 0x8006,
            Self::Busy => 0x8007,
            Self::PacketUnavailable => 0x800C,
            Self::InvalidHeader => 0x800E,
            Self::Error => 0x8FFF,
        }
    }
}

const DISCOVERY: u16 = 0x0002;
const FORCE_IP: u16 = 0x0004;
const PACKET_RESEND: u16 = 0x0040;
const READ_REGISTER: u16 = 0x0080;
const WRITE_REGISTER: u16 = 0x0082;
const READ_MEMORY: u16 = 0x0084;
const WRITE_MEMORY: u16 = 0x0086;
const PENDING_ACK: u16 = 0x0089;

/// Which packets of a block are wanted again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ResendRange {
    /// Block id.
    pub(super) block: u64,
    /// First packet.
    pub(super) first: u32,
    /// Last packet, inclusive.
    pub(super) last: u32,
}

/// What a client asks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Command {
    /// Who is there?
    Discovery,
    /// Take another address; always refused here.
    ForceIp,
    /// Send packets again.
    PacketResend {
        /// Stream channel; only 0 exists.
        channel: u16,
        /// Which packets.
        range: ResendRange,
    },
    /// Read registers at these addresses.
    ReadRegister(Vec<u32>),
    /// Write registers: address and value, in order.
    WriteRegister(Vec<(u32, u32)>),
    /// Read memory.
    ReadMemory {
        /// First byte.
        address: u32,
        /// Bytes.
        count: u16,
    },
    /// Write memory.
    WriteMemory {
        /// First byte.
        address: u32,
        /// The new bytes.
        bytes: Vec<u8>,
    },
    /// Anything else.
    Unknown,
}

/// A command with its header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Request {
    /// Number of the command on the wire.
    pub(super) number: u16,
    /// Request id, never 0.
    pub(super) id: u16,
    /// Whether an acknowledge is wanted.
    pub(super) acknowledge: bool,
    /// The command, or why its payload cannot be read.
    pub(super) command: Result<Command, Status>,
}

impl Request {
    /// Reads a datagram; `None` for what is not a command at all and deserves no answer.
    pub(super) fn parse(bytes: &[u8]) -> Option<Self> {
        let header: &[u8; HEADER_BYTES] = bytes.first_chunk()?;
        let id = be16(&header[6..])?;
        if header[0] != KEY || id == 0 {
            return None;
        }
        let flags = header[1];
        let number = be16(&header[2..])?;
        let length = usize::from(be16(&header[4..])?);
        let payload = &bytes[HEADER_BYTES..];
        let command = if length == payload.len() && length <= PAYLOAD_BYTES_MAX {
            parse_payload(number, flags, payload)
        } else {
            Err(Status::InvalidHeader)
        };
        Some(Self { number, id, acknowledge: flags & 1 != 0, command })
    }
}

fn parse_payload(number: u16, flags: u8, payload: &[u8]) -> Result<Command, Status> {
    const MALFORMED: Status = Status::InvalidParameter;
    match number {
        DISCOVERY => Ok(Command::Discovery),
        FORCE_IP => Ok(Command::ForceIp),
        PACKET_RESEND => parse_resend(flags, payload).ok_or(MALFORMED),
        READ_REGISTER => {
            let (words, rest) = payload.as_chunks::<4>();
            if words.is_empty() || !rest.is_empty() {
                return Err(MALFORMED);
            }
            Ok(Command::ReadRegister(words.iter().map(|&word| u32::from_be_bytes(word)).collect()))
        }
        WRITE_REGISTER => {
            let (pairs, rest) = payload.as_chunks::<8>();
            if pairs.is_empty() || !rest.is_empty() {
                return Err(MALFORMED);
            }
            let pair = |p: &[u8; 8]| Some((be32(p)?, be32(&p[4..])?));
            Ok(Command::WriteRegister(pairs.iter().filter_map(pair).collect()))
        }
        READ_MEMORY if payload.len() == 8 => {
            let address = be32(payload).ok_or(MALFORMED)?;
            let count = be16(&payload[6..]).ok_or(MALFORMED)?;
            if count == 0 || usize::from(count) > MEMORY_BYTES_MAX {
                return Err(MALFORMED);
            }
            Ok(Command::ReadMemory { address, count })
        }
        WRITE_MEMORY if payload.len() > 4 => {
            let address = be32(payload).ok_or(MALFORMED)?;
            Ok(Command::WriteMemory { address, bytes: payload[4..].to_vec() })
        }
        READ_MEMORY | WRITE_MEMORY => Err(MALFORMED),
        _ => Ok(Command::Unknown),
    }
}

/// Flag of a PACKETRESEND with 64-bit block ids.
const EXTENDED: u8 = 0x10;

fn parse_resend(flags: u8, payload: &[u8]) -> Option<Command> {
    let channel = be16(payload)?;
    let (first, last) = (be32(payload.get(4..)?)?, be32(payload.get(8..)?)?);
    let range = if flags & EXTENDED != 0 {
        let block: [u8; 8] = *payload.get(12..)?.first_chunk()?;
        ResendRange { block: u64::from_be_bytes(block), first, last }
    } else {
        // Packet ids of standard blocks have 24 bits; the upper byte is reserved.
        let block = u64::from(be16(&payload[2..])?);
        ResendRange { block, first: first & 0x00FF_FFFF, last: last & 0x00FF_FFFF }
    };
    Some(Command::PacketResend { channel, range })
}

fn be16(bytes: &[u8]) -> Option<u16> {
    bytes.first_chunk().map(|&chunk| u16::from_be_bytes(chunk))
}

fn be32(bytes: &[u8]) -> Option<u32> {
    bytes.first_chunk().map(|&chunk| u32::from_be_bytes(chunk))
}

/// An acknowledge of command `number` (without the +1) with its payload.
pub(super) fn acknowledge(status: Status, number: u16, id: u16, payload: &[u8]) -> Vec<u8> {
    answer(status, number.wrapping_add(1), id, payload)
}

/// "Still busy": the client waits up to `wait_ms` more, in milliseconds.
pub(super) fn pending(id: u16, wait_ms: u16) -> Vec<u8> {
    let [high, low] = wait_ms.to_be_bytes();
    answer(Status::Success, PENDING_ACK, id, &[0, 0, high, low])
}

fn answer(status: Status, number: u16, id: u16, payload: &[u8]) -> Vec<u8> {
    let length = u16::try_from(payload.len()).expect("acknowledges are limited to 540 bytes");
    let mut bytes = Vec::with_capacity(HEADER_BYTES + payload.len());
    for field in [status.code(), number, length, id] {
        bytes.extend(field.to_be_bytes());
    }
    bytes.extend(payload);
    bytes
}

/// The client's side of the codec: what a test needs to ask.
#[cfg(test)]
pub(super) mod client {
    use super::*;

    /// The bytes of a command.
    pub(in super::super) fn command(command: &Command, id: u16) -> Vec<u8> {
        let mut flags = 1;
        let mut payload = Vec::new();
        let number = match command {
            Command::Discovery => DISCOVERY,
            Command::ForceIp => FORCE_IP,
            Command::PacketResend { channel, range } => {
                flags = 0;
                payload.extend(channel.to_be_bytes());
                let short = u16::try_from(range.block).ok();
                payload.extend(short.unwrap_or(0).to_be_bytes());
                payload.extend(range.first.to_be_bytes());
                payload.extend(range.last.to_be_bytes());
                if short.is_none() {
                    flags |= EXTENDED;
                    payload.extend(range.block.to_be_bytes());
                }
                PACKET_RESEND
            }
            Command::ReadRegister(addresses) => {
                payload.extend(addresses.iter().flat_map(|a| a.to_be_bytes()));
                READ_REGISTER
            }
            Command::WriteRegister(pairs) => {
                payload.extend(pairs.iter().flat_map(|(a, v)| [a.to_be_bytes(), v.to_be_bytes()].concat()));
                WRITE_REGISTER
            }
            Command::ReadMemory { address, count } => {
                payload.extend(address.to_be_bytes());
                payload.extend([0, 0]);
                payload.extend(count.to_be_bytes());
                READ_MEMORY
            }
            Command::WriteMemory { address, bytes } => {
                payload.extend(address.to_be_bytes());
                payload.extend(bytes);
                WRITE_MEMORY
            }
            Command::Unknown => 0x0100,
        };
        let length = u16::try_from(payload.len()).unwrap_or(u16::MAX);
        let mut bytes = vec![KEY, flags];
        bytes.extend(number.to_be_bytes());
        bytes.extend(length.to_be_bytes());
        bytes.extend(id.to_be_bytes());
        bytes.extend(payload);
        bytes
    }

    /// Status, number, id and payload of an acknowledge.
    pub(in super::super) fn answer(bytes: &[u8]) -> Option<(u16, u16, u16, Vec<u8>)> {
        let length = usize::from(be16(bytes.get(4..)?)?);
        let payload = bytes.get(HEADER_BYTES..HEADER_BYTES + length)?.to_vec();
        Some((be16(bytes)?, be16(&bytes[2..])?, be16(&bytes[6..])?, payload))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_survives_the_wire() {
        let range = ResendRange { block: 65535, first: 3, last: 17 };
        let long = ResendRange { block: 1 << 40, first: 0, last: 1 << 25 };
        for asked in [
            Command::Discovery,
            Command::ForceIp,
            Command::PacketResend { channel: 0, range },
            Command::PacketResend { channel: 0, range: long },
            Command::ReadRegister(vec![0x0A00, 0x0D04]),
            Command::WriteRegister(vec![(0x0A00, 2), (0x0938, 3000)]),
            Command::ReadMemory { address: 0x200, count: 512 },
            Command::WriteMemory { address: 0xE8, bytes: vec![1, 2, 3, 4] },
            Command::Unknown,
        ] {
            let request = Request::parse(&client::command(&asked, 7)).unwrap();
            assert_eq!(request.command, Ok(asked.clone()));
            assert_eq!(request.id, 7);
            assert_eq!(request.acknowledge, !matches!(asked, Command::PacketResend { .. }));
        }
    }

    /// Bytes of a READREG of the control privilege as Aravis sends it, and of its answer.
    #[test]
    fn bytes_are_those_of_the_standard() {
        let bytes = [0x42, 0x01, 0x00, 0x80, 0x00, 0x04, 0x12, 0x34, 0x00, 0x00, 0x0A, 0x00];
        let request = Request::parse(&bytes).unwrap();
        assert_eq!(request.command, Ok(Command::ReadRegister(vec![0x0A00])));
        assert_eq!(request.id, 0x1234);
        let answer = acknowledge(Status::Success, request.number, request.id, &[0, 0, 0, 2]);
        assert_eq!(answer, [0, 0, 0, 0x81, 0, 4, 0x12, 0x34, 0, 0, 0, 2]);
        assert_eq!(pending(9, 500), [0, 0, 0, 0x89, 0, 4, 0, 9, 0, 0, 1, 0xF4]);
        assert_eq!(acknowledge(Status::AccessDenied, 0x82, 1, &[])[..2], [0x80, 0x06]);
    }

    #[test]
    fn what_is_no_command_gets_no_answer() {
        let good = client::command(&Command::ReadRegister(vec![0]), 5);
        for length in 0..HEADER_BYTES {
            assert_eq!(Request::parse(&good[..length]), None);
        }
        let mut key = good.clone();
        key[0] = 0x43;
        let mut zero = good.clone();
        zero[6..8].fill(0);
        assert!(Request::parse(&key).is_none() && Request::parse(&zero).is_none());
    }

    #[test]
    fn malformed_payloads_are_named_not_guessed() {
        let mut cut = client::command(&Command::ReadRegister(vec![0]), 5);
        cut.pop();
        assert_eq!(Request::parse(&cut).unwrap().command, Err(Status::InvalidHeader));
        for (number, payload) in [
            (READ_REGISTER, vec![0; 6]),
            (READ_REGISTER, vec![]),
            (WRITE_REGISTER, vec![0; 12]),
            (READ_MEMORY, vec![0; 4]),
            (READ_MEMORY, vec![0; 8]),
            (READ_MEMORY, vec![0, 0, 0, 0, 0, 0, 0xFF, 0xFC]),
            (WRITE_MEMORY, vec![0; 4]),
            (PACKET_RESEND, vec![0; 8]),
        ] {
            let mut bytes = answer(Status::Success, number, 5, &payload);
            bytes[..2].copy_from_slice(&[KEY, 1]);
            let command = Request::parse(&bytes).unwrap().command;
            assert_eq!(command, Err(Status::InvalidParameter), "{number:04x}");
        }
    }
}
