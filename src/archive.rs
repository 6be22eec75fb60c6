//! Reads frames back from a run folder, by file and index, with their checksum.

use crate::campaign::crc_of;
use crate::reduce::FrameSource;
use std::collections::HashMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Length of the header of our frame blocks, in bytes.
const HEADER_BYTES: u64 = 128;

/// Frames of a run folder.
#[derive(Debug)]
pub struct Archive {
    folder: PathBuf,
    pixels: usize,
    open: HashMap<String, File>,
    buffer: Vec<u8>,
}

impl Archive {
    /// For a folder whose frames have `pixels` pixels.
    pub fn new(folder: &Path, pixels: usize) -> Self {
        Self { folder: folder.to_owned(), pixels, open: HashMap::new(), buffer: vec![0; 2 * pixels] }
    }
}

impl FrameSource for Archive {
    fn load(&mut self, file: &str, index: u64, crc32: u32) -> Result<Arc<[u16]>, String> {
        // Names come from the journal: nothing outside the folder is ever opened.
        if file.split('/').any(|part| part == ".." || part.is_empty()) {
            return Err(format!("{file} is no file of a run folder"));
        }
        let path = self.folder.join(file);
        let at = HEADER_BYTES + index * self.buffer.len() as u64;
        if !self.open.contains_key(file) {
            let opened = File::open(&path).map_err(|error| format!("{}: {error}", path.display()))?;
            self.open.insert(file.to_owned(), opened);
        }
        let handle = self.open.get_mut(file).expect("it was opened above");
        handle
            .seek(SeekFrom::Start(at))
            .and_then(|_| handle.read_exact(&mut self.buffer))
            .map_err(|error| format!("{}, frame {index}: {error}", path.display()))?;
        let counts: Arc<[u16]> =
            self.buffer.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect();
        debug_assert_eq!(counts.len(), self.pixels);
        let found = crc_of(&counts);
        if found != crc32 {
            return Err(format!(
                "{}, frame {index}: CRC-32 {found:08x} where the journal says {crc32:08x}",
                path.display()
            ));
        }
        Ok(counts)
    }
}
