//! Addresses and bits of the standard's own registers.
//!
//! Those of the GigE Vision standard as the public headers of Aravis 0.8.26 and Wireshark's dissector give them.

/// Ticks of the camera's clock in a second: one is a nanosecond, as in the frames of the camera behind.
pub(super) const TICKS_PER_SECOND: u32 = 1_000_000_000;

/// Bytes of the discovery answer: the memory from 0.
pub(super) const DISCOVERY_BYTES: u16 = 0xF8;

/// First byte of the description.
pub(super) const XML_BASE: u32 = 0x0010_0000;

/// End of the readable bootstrap registers.
pub(super) const BOOTSTRAP_BYTES: u32 = 0x0E00;

pub(super) const VERSION: u32 = 0x0000;
pub(super) const MODE: u32 = 0x0004;
pub(super) const MAC_HIGH: u32 = 0x0008;
pub(super) const MAC_LOW: u32 = 0x000C;
pub(super) const IP_CAPABILITY: u32 = 0x0010;
pub(super) const IP_CONFIGURATION: u32 = 0x0014;
pub(super) const IP_ADDRESS: u32 = 0x0024;
pub(super) const IP_MASK: u32 = 0x0034;
pub(super) const MAKER: u32 = 0x0048;
pub(super) const MODEL: u32 = 0x0068;
pub(super) const DEVICE_VERSION: u32 = 0x0088;
pub(super) const MAKER_INFO: u32 = 0x00A8;
pub(super) const SERIAL: u32 = 0x00D8;
pub(super) const USER_NAME: u32 = 0x00E8;
pub(super) const USER_NAME_BYTES: u32 = 16;
pub(super) const XML_URL: u32 = 0x0200;
pub(super) const INTERFACES: u32 = 0x0600;
pub(super) const STREAM_CHANNELS: u32 = 0x0904;
pub(super) const GVSP_CAPABILITY: u32 = 0x092C;
pub(super) const GVCP_CAPABILITY: u32 = 0x0934;
pub(super) const HEARTBEAT_TIMEOUT: u32 = 0x0938;
pub(super) const TICKS_HIGH: u32 = 0x093C;
pub(super) const TICKS_LOW: u32 = 0x0940;
pub(super) const TIMESTAMP_CONTROL: u32 = 0x0944;
pub(super) const TIMESTAMP_HIGH: u32 = 0x0948;
pub(super) const TIMESTAMP_LOW: u32 = 0x094C;
pub(super) const GVCP_CONFIGURATION: u32 = 0x0954;
pub(super) const PENDING_TIMEOUT: u32 = 0x0958;
pub(super) const GVSP_CONFIGURATION: u32 = 0x0960;
/// Control privilege.
pub(super) const CONTROL: u32 = 0x0A00;
pub(super) const PRIMARY_PORT: u32 = 0x0A04;
pub(super) const PRIMARY_ADDRESS: u32 = 0x0A14;
pub(super) const STREAM_PORT: u32 = 0x0D00;
pub(super) const PACKET_SIZE: u32 = 0x0D04;
pub(super) const PACKET_DELAY: u32 = 0x0D08;
pub(super) const STREAM_ADDRESS: u32 = 0x0D18;
pub(super) const STREAM_SOURCE_PORT: u32 = 0x0D1C;
pub(super) const STREAM_CONFIGURATION: u32 = 0x0D24;

/// Bits of the control privilege.
pub(super) const EXCLUSIVE: u32 = 1;
pub(super) const CONTROLLING: u32 = 2;
