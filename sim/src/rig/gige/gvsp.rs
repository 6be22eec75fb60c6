//! The stream protocol's packets (GVSP): a frame's payload to packets, one at a time, and back for a client.
//!
//! Pure: knows no socket and no fault. Packet 0 is the leader, the last one the trailer, those between carry the
//! payload in order, all full but the last. Layouts are those of the GigE Vision standard as the public headers of
//! Aravis 0.8.26 and Wireshark's dissector give them; all header numbers are big-endian.

use super::gvcp::Status;

/// Bytes of IP and UDP headers that the packet size register counts.
pub(super) const IP_UDP_BYTES: usize = 28;

/// Bytes of a leader's content.
const LEADER_BYTES: usize = 36;

const FORMAT_LEADER: u8 = 1;
const FORMAT_TRAILER: u8 = 2;
const FORMAT_PAYLOAD: u8 = 3;
const FORMAT_EXTENDED: u8 = 0x80;

/// How blocks and packets are numbered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum IdMode {
    /// Block ids 1 … 65535 (never 0), packet ids of 24 bits.
    Standard,
    /// Block ids of 64 bits, packet ids of 32 bits.
    Extended,
}

impl IdMode {
    /// Bytes of a packet's header.
    pub(super) fn header_bytes(self) -> usize {
        match self {
            Self::Standard => 8,
            Self::Extended => 20,
        }
    }

    /// The block id that comes `step` frames after `block`.
    pub(super) fn after(self, block: u64, step: u64) -> u64 {
        match self {
            Self::Standard => (block - 1).wrapping_add(step) % 65535 + 1,
            Self::Extended => block.saturating_add(step),
        }
    }
}

/// What a block contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PayloadType {
    /// An image.
    Image,
    /// An image followed by chunks.
    ImageWithChunks,
}

impl PayloadType {
    fn code(self) -> u16 {
        match self {
            Self::Image => 0x0001,
            Self::ImageWithChunks => 0x4001,
        }
    }
}

/// What the leader of a block says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Leader {
    /// What the block contains.
    pub(super) payload_type: PayloadType,
    /// Ticks of the camera's clock at the start of the exposure.
    pub(super) timestamp: u64,
    /// Pixel format code (PFNC).
    pub(super) pixel_format: u32,
    /// Columns.
    pub(super) width: u32,
    /// Rows.
    pub(super) height: u32,
    /// First column on the sensor.
    pub(super) offset_x: u32,
    /// First row on the sensor.
    pub(super) offset_y: u32,
}

/// A block ready to be cut into packets.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Block {
    /// Block id as it goes over the wire.
    pub(super) id: u64,
    /// How ids are written.
    pub(super) ids: IdMode,
    /// The leader.
    pub(super) leader: Leader,
    /// Image and chunks.
    pub(super) payload: Vec<u8>,
    /// Size of a packet with IP, UDP and GVSP headers, in bytes.
    pub(super) packet_bytes: usize,
    /// First payload byte that does not exist: the camera itself lost the rest. Equal to the payload's length for a
    /// whole frame.
    pub(super) present_bytes: usize,
}

impl Block {
    /// Payload bytes of a full packet.
    pub(super) fn bytes_per_packet(&self) -> usize {
        (self.packet_bytes - IP_UDP_BYTES - self.ids.header_bytes()).max(1)
    }

    /// Number of packets, leader and trailer included.
    pub(super) fn packets(&self) -> u32 {
        let payload = self.payload.len().div_ceil(self.bytes_per_packet());
        u32::try_from(payload + 2).expect("a frame has less than 2^32 packets")
    }

    /// Writes packet `packet` into `out`, which is cleared first. False, and nothing written, when there is none.
    pub(super) fn write_packet(&self, packet: u32, out: &mut Vec<u8>) -> bool {
        out.clear();
        let packets = self.packets();
        if packet >= packets {
            return false;
        }
        if packet == 0 {
            self.write_header(Status::Success, FORMAT_LEADER, packet, out);
            self.write_leader(out);
        } else if packet == packets - 1 {
            self.write_header(Status::Success, FORMAT_TRAILER, packet, out);
            out.extend([0, 0]);
            out.extend(self.leader.payload_type.code().to_be_bytes());
            out.extend(self.leader.height.to_be_bytes());
        } else {
            let size = self.bytes_per_packet();
            let start = (packet as usize - 1) * size;
            if start + size.min(self.payload.len() - start) > self.present_bytes {
                return false;
            }
            self.write_header(Status::Success, FORMAT_PAYLOAD, packet, out);
            out.extend(&self.payload[start..self.payload.len().min(start + size)]);
        }
        true
    }

    fn write_header(&self, status: Status, format: u8, packet: u32, out: &mut Vec<u8>) {
        header(status, self.ids, self.id, format, packet, out);
    }

    fn write_leader(&self, out: &mut Vec<u8>) {
        let leader = &self.leader;
        let start = out.len();
        out.extend([0, 0]);
        out.extend(leader.payload_type.code().to_be_bytes());
        out.extend(leader.timestamp.to_be_bytes());
        for field in [leader.pixel_format, leader.width, leader.height, leader.offset_x, leader.offset_y] {
            out.extend(field.to_be_bytes());
        }
        // No padding of lines or frames.
        out.extend([0; 4]);
        debug_assert_eq!(out.len() - start, LEADER_BYTES);
    }
}

/// The answer to a resend request of a packet that is no longer there.
pub(super) fn unavailable(ids: IdMode, block: u64, packet: u32) -> Vec<u8> {
    let mut out = Vec::new();
    header(Status::PacketUnavailable, ids, block, FORMAT_PAYLOAD, packet, &mut out);
    out
}

fn header(status: Status, ids: IdMode, block: u64, format: u8, packet: u32, out: &mut Vec<u8>) {
    out.extend(status.code().to_be_bytes());
    let [_, p2, p1, p0] = packet.to_be_bytes();
    match ids {
        IdMode::Standard => {
            let [.., b1, b0] = block.to_be_bytes();
            out.extend([b1, b0, format, p2, p1, p0]);
        }
        IdMode::Extended => {
            out.extend([0, 0, FORMAT_EXTENDED | format, 0, 0, 0]);
            out.extend(block.to_be_bytes());
            out.extend(packet.to_be_bytes());
        }
    }
}

/// A test packet: a datagram of `packet_bytes` less the IP and UDP headers, with a counting pattern.
pub(super) fn test_packet(packet_bytes: usize) -> Vec<u8> {
    #[expect(clippy::cast_possible_truncation, reason = "the pattern repeats every 256 bytes")]
    let pattern = (0..packet_bytes.saturating_sub(IP_UDP_BYTES)).map(|i| i as u8);
    pattern.collect()
}

/// The client's side of the codec: what a test needs to read a stream.
#[cfg(test)]
pub(super) mod client {
    use super::*;

    /// A packet as received.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub(in super::super) struct Packet {
        pub(in super::super) status: u16,
        pub(in super::super) block: u64,
        pub(in super::super) format: u8,
        pub(in super::super) packet: u32,
        pub(in super::super) content: Vec<u8>,
    }

    pub(in super::super) const LEADER: u8 = FORMAT_LEADER;
    pub(in super::super) const TRAILER: u8 = FORMAT_TRAILER;
    pub(in super::super) const PAYLOAD: u8 = FORMAT_PAYLOAD;

    /// Reads a packet; `None` when it is too short.
    pub(in super::super) fn parse(bytes: &[u8]) -> Option<Packet> {
        let number = |from: usize, count: usize| {
            let field = bytes.get(from..from + count)?;
            Some(field.iter().fold(0_u64, |n, b| n << 8 | u64::from(*b)))
        };
        let status = u16::try_from(number(0, 2)?).ok()?;
        let format = u8::try_from(number(4, 1)?).ok()?;
        let extended = format & FORMAT_EXTENDED != 0;
        let (block, packet, rest) =
            if extended { (number(8, 8)?, number(16, 4)?, 20) } else { (number(2, 2)?, number(5, 3)?, 8) };
        let packet = u32::try_from(packet).ok()?;
        let content = bytes.get(rest..)?.to_vec();
        Some(Packet { status, block, format: format & !FORMAT_EXTENDED, packet, content })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(ids: IdMode, payload: usize, packet_bytes: usize) -> Block {
        let leader = Leader {
            payload_type: PayloadType::Image,
            timestamp: 0x0102_0304_0506_0708,
            pixel_format: 0x0110_0007,
            width: 640,
            height: 512,
            offset_x: 4,
            offset_y: 2,
        };
        let payload: Vec<u8> = (0..=250).cycle().take(payload).collect();
        let present_bytes = payload.len();
        Block { id: 0x1234, ids, leader, payload, packet_bytes, present_bytes }
    }

    #[test]
    fn packets_join_to_the_payload_and_none_is_too_long() {
        for ids in [IdMode::Standard, IdMode::Extended] {
            for (payload, size) in [(655_360, 1500), (655_360, 9000), (1464, 1500), (1465, 1500), (2, 576)] {
                let block = block(ids, payload, size);
                let mut out = Vec::new();
                let mut joined = Vec::new();
                for packet in 0..block.packets() {
                    assert!(block.write_packet(packet, &mut out));
                    assert!(out.len() + IP_UDP_BYTES <= size);
                    let read = client::parse(&out).unwrap();
                    assert_eq!((read.status, read.block, read.packet), (0, 0x1234, packet));
                    let last = block.packets() - 1;
                    let format = match packet {
                        0 => client::LEADER,
                        p if p == last => client::TRAILER,
                        _ => client::PAYLOAD,
                    };
                    assert_eq!(read.format, format);
                    if format == client::PAYLOAD {
                        assert!(read.content.len() == block.bytes_per_packet() || packet == last - 1);
                        joined.extend(read.content);
                    }
                }
                assert!(!block.write_packet(block.packets(), &mut out) && out.is_empty());
                assert_eq!(joined, block.payload);
            }
        }
    }

    #[test]
    fn leader_bytes_are_those_of_the_standard() {
        let mut out = Vec::new();
        block(IdMode::Standard, 100, 1500).write_packet(0, &mut out);
        assert_eq!(out[..12], [0, 0, 0x12, 0x34, 1, 0, 0, 0, 0, 0, 0, 1]);
        assert_eq!(out[12..20], [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(out[20..32], [0x01, 0x10, 0, 7, 0, 0, 2, 0x80, 0, 0, 2, 0]);
        assert_eq!(out.len(), 8 + LEADER_BYTES);
        block(IdMode::Extended, 100, 1500).write_packet(1, &mut out);
        assert_eq!(out[..8], [0, 0, 0, 0, 0x83, 0, 0, 0]);
        assert_eq!(out[8..20], [0, 0, 0, 0, 0, 0, 0x12, 0x34, 0, 0, 0, 1]);
    }

    #[test]
    fn standard_ids_skip_zero() {
        assert_eq!(IdMode::Standard.after(65535, 1), 1);
        assert_eq!(IdMode::Standard.after(65534, 3), 2);
        assert_eq!(IdMode::Standard.after(1, 65535), 1);
        assert_eq!(IdMode::Extended.after(65535, 1), 65536);
    }

    #[test]
    fn missing_half_cannot_be_sent() {
        let mut half = block(IdMode::Standard, 14_640, 1500);
        half.present_bytes = 7000;
        let mut out = Vec::new();
        let sent: Vec<u32> = (0..half.packets()).filter(|&p| half.write_packet(p, &mut out)).collect();
        // Four whole packets of 1464 bytes lie within 7000 bytes.
        assert_eq!(sent, [0, 1, 2, 3, 4, 11]);
        let gone = client::parse(&unavailable(IdMode::Standard, 5, 6)).unwrap();
        assert_eq!((gone.status, gone.block, gone.packet), (0x800C, 5, 6));
    }

    #[test]
    fn test_packet_fills_the_packet_size() {
        assert_eq!(test_packet(1500).len(), 1472);
    }
}
