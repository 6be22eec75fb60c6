//! From the bytes of a picture to counts: pixel formats, alignment of the bits, rows of header. Pure.

/// Formats of a pixel that carry raw counts, by their number in the Pixel Format Naming Convention.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelFormat {
    /// 14 bits in two bytes, low end first.
    Mono14,
    /// 16 bits in two bytes, low end first.
    Mono16,
}

/// The `Mono14` of the naming convention.
pub const MONO14: u32 = 0x0110_0025;

/// The `Mono16` of the naming convention.
pub const MONO16: u32 = 0x0110_0007;

impl PixelFormat {
    /// The format of a number; `None` for formats that carry no raw counts.
    pub fn of(number: u32) -> Option<Self> {
        match number {
            MONO14 => Some(Self::Mono14),
            MONO16 => Some(Self::Mono16),
            _ => None,
        }
    }

    /// Its name as the camera spells it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mono14 => "Mono14",
            Self::Mono16 => "Mono16",
        }
    }

    /// The format that carries counts of so many bits with the fewest surprises.
    pub fn for_bits(bits: u32) -> Self {
        if bits == 14 { Self::Mono14 } else { Self::Mono16 }
    }
}

/// Where the counts lie in a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Rows of counts.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Rows of header above them.
    pub header_rows: usize,
    /// Bits by which the counts are shifted up.
    pub shift: u32,
    /// Bits of a count.
    pub bits: u32,
}

impl Layout {
    /// Bytes of a whole picture.
    pub fn bytes(&self) -> usize {
        (self.rows + self.header_rows) * self.columns * 2
    }

    /// The counts of a picture, `[row, column]`, row 0 at the top, and whether they fill it: bytes that are missing
    /// are counts of zero.
    ///
    /// # Errors
    /// A pixel that no sensor of so many bits can give: the format is not what it claims to be.
    pub fn counts(&self, bytes: &[u8]) -> Result<(Vec<u16>, bool), String> {
        let skipped = self.header_rows * self.columns * 2;
        let wanted = self.rows * self.columns;
        let picture = bytes.get(skipped..).unwrap_or_default();
        let mut counts: Vec<u16> = Vec::with_capacity(wanted);
        let low_mask = (1_u16 << self.shift) - 1;
        let mut all = 0_u16;
        counts.extend(picture.chunks_exact(2).take(wanted).map(|pair| {
            let raw = u16::from_le_bytes([pair[0], pair[1]]);
            all |= raw;
            raw >> self.shift
        }));
        let complete = counts.len() == wanted && bytes.len() >= self.bytes();
        counts.resize(wanted, 0);
        if all & low_mask != 0 {
            return Err(format!(
                "low bits are set ({:#06x}) where a count shifted up by {} leaves them empty",
                all & low_mask,
                self.shift
            ));
        }
        let highest = u32::from(all >> self.shift);
        if highest >= 1 << self.bits {
            return Err(format!("a pixel has bits above the {} of the sensor ({highest:#06x})", self.bits));
        }
        Ok((counts, complete))
    }
}

/// What the header of a Telops frame says (pyTelops 0.2.5; 256 bytes, little-endian).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TelopsHeader {
    /// Frame number.
    pub frame_id: u32,
    /// Integration time in seconds.
    pub exposure_s: f64,
    /// Start of the exposure, nanoseconds of POSIX time.
    pub posix_ns: u64,
}

impl TelopsHeader {
    /// Reads the header at the start of a picture; `None` when there is none.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        if bytes.get(..2)? != b"TC" {
            return None;
        }
        let word = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
        Some(Self {
            frame_id: word(8)?,
            exposure_s: f64::from(word(24)?) * 1e-8,
            posix_ns: u64::from(word(100)?) * 1_000_000_000 + u64::from(word(104)?) * 100,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(counts: &[u16]) -> Vec<u8> {
        counts.iter().flat_map(|count| count.to_le_bytes()).collect()
    }

    fn layout(rows: usize, header_rows: usize, shift: u32) -> Layout {
        Layout { rows, columns: 2, header_rows, shift, bits: 14 }
    }

    #[test]
    fn counts_come_out_as_they_were_whatever_the_alignment() {
        let counts = [1, 2, 16383, 4];
        assert_eq!(layout(2, 0, 0).counts(&bytes(&counts)), Ok((counts.to_vec(), true)));
        let shifted: Vec<u16> = counts.iter().map(|count| count << 2).collect();
        assert_eq!(layout(2, 0, 2).counts(&bytes(&shifted)), Ok((counts.to_vec(), true)));
        let with_header = [&[0xffff, 0xffff, 0xffff, 0xffff][..], &counts].concat();
        assert_eq!(layout(2, 2, 0).counts(&bytes(&with_header)), Ok((counts.to_vec(), true)));
    }

    #[test]
    fn a_short_picture_is_incomplete_and_never_shifted() {
        let got = layout(2, 0, 0).counts(&bytes(&[7, 8, 9])).unwrap();
        assert_eq!(got, (vec![7, 8, 9, 0], false));
        assert_eq!(layout(2, 2, 0).counts(&[1, 2]).unwrap(), (vec![0; 4], false));
    }

    #[test]
    fn a_wrong_alignment_is_seen() {
        assert!(layout(1, 0, 2).counts(&bytes(&[5, 8])).unwrap_err().contains("low bits"));
        assert!(layout(1, 0, 0).counts(&bytes(&[5, 65_000])).unwrap_err().contains("above the 14"));
    }

    #[test]
    fn a_telops_header_is_read_where_there_is_one() {
        let mut header = vec![0_u8; 256];
        header[..2].copy_from_slice(b"TC");
        header[8..12].copy_from_slice(&77_u32.to_le_bytes());
        header[24..28].copy_from_slice(&2500_u32.to_le_bytes());
        header[100..104].copy_from_slice(&1_700_000_000_u32.to_le_bytes());
        header[104..108].copy_from_slice(&5_u32.to_le_bytes());
        let read = TelopsHeader::read(&header).unwrap();
        assert_eq!((read.frame_id, read.posix_ns), (77, 1_700_000_000_000_000_500));
        assert!((read.exposure_s - 25e-6).abs() < 1e-15);
        assert_eq!(TelopsHeader::read(&[0; 256]), None);
        assert_eq!(TelopsHeader::read(b"TC"), None);
    }
}
