//! The run folder: what lies where, and the files that explain it to a stranger.

use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Trouble with a file of the run folder.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {doing}: {source}")]
pub struct FolderError {
    /// The file or folder.
    pub path: PathBuf,
    /// The act.
    pub doing: &'static str,
    /// The system's words.
    pub source: std::io::Error,
}

/// Paths below a run folder.
#[derive(Debug, Clone)]
pub struct RunFolder {
    root: PathBuf,
}

impl RunFolder {
    /// A folder that may or may not exist yet.
    pub fn at(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    /// Makes the folder; one that already holds a journal is refused.
    ///
    /// # Errors
    ///
    /// [`FolderError`] when it holds a run already or cannot be made.
    pub fn create(root: &Path) -> Result<Self, FolderError> {
        let folder = Self::at(root);
        if folder.journal().exists() || folder.campaign().exists() {
            return Err(FolderError {
                path: root.to_owned(),
                doing: "starting a run here",
                source: std::io::Error::other(
                    "it already holds a run, and nothing recorded is ever overwritten",
                ),
            });
        }
        std::fs::create_dir_all(root).map_err(at(root, "making the folder"))?;
        Ok(folder)
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The campaign file as run.
    pub fn campaign(&self) -> PathBuf {
        self.root.join("campaign.toml")
    }

    /// The journal.
    pub fn journal(&self) -> PathBuf {
        self.root.join("journal.jsonl")
    }

    /// The folder of the calibration that was used.
    pub fn calibration(&self) -> PathBuf {
        self.root.join("calibration")
    }

    /// The results.
    pub fn result(&self) -> PathBuf {
        self.root.join("result")
    }

    /// What the simulated world knows of itself; only on a simulated rig.
    pub fn world(&self) -> PathBuf {
        self.root.join("world")
    }

    /// Writes one file.
    ///
    /// # Errors
    ///
    /// [`FolderError`] when the system refuses.
    pub fn write(&self, path: &Path, bytes: &[u8]) -> Result<(), FolderError> {
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(at(parent, "making the folder"))?;
        }
        std::fs::write(path, bytes).map_err(at(path, "writing"))
    }

    /// Writes `README.txt`, `ro-crate-metadata.json` and, last, `manifest-sha256.txt` over all other files.
    ///
    /// # Errors
    ///
    /// [`FolderError`] when the system refuses.
    pub fn seal(&self, name: &str, utc: &str) -> Result<(), FolderError> {
        self.write(&self.root.join("README.txt"), readme(name, utc).as_bytes())?;
        let listed = self.files()?;
        let crate_file = self.root.join("ro-crate-metadata.json");
        self.write(&crate_file, ro_crate(name, utc, &listed).as_bytes())?;
        let mut manifest = String::new();
        for file in self.files()? {
            let digest = sha256_file(&self.root.join(&file))?;
            // Writing to a String cannot fail.
            let _ = writeln!(manifest, "{digest}  {file}");
        }
        self.write(&self.root.join("manifest-sha256.txt"), manifest.as_bytes())
    }

    /// All files below the folder but the manifest, sorted, with `/` between folders.
    fn files(&self) -> Result<Vec<String>, FolderError> {
        let mut found = Vec::new();
        let mut open = vec![self.root.clone()];
        while let Some(folder) = open.pop() {
            for entry in std::fs::read_dir(&folder).map_err(at(&folder, "listing"))? {
                let path = entry.map_err(at(&folder, "listing"))?.path();
                if path.is_dir() {
                    open.push(path);
                } else if let Ok(below) = path.strip_prefix(&self.root) {
                    let name: Vec<_> = below.iter().map(|part| part.to_string_lossy()).collect();
                    found.push(name.join("/"));
                }
            }
        }
        found.retain(|name| name != "manifest-sha256.txt");
        found.sort();
        Ok(found)
    }
}

fn at<'a>(path: &'a Path, doing: &'static str) -> impl FnOnce(std::io::Error) -> FolderError + 'a {
    move |source| FolderError { path: path.to_owned(), doing, source }
}

/// SHA-256 of bytes, in hex.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::new(), |mut hex, byte| {
        let _ = write!(hex, "{byte:02x}");
        hex
    })
}

fn sha256_file(path: &Path) -> Result<String, FolderError> {
    let mut file = std::fs::File::open(path).map_err(at(path, "reading"))?;
    let mut hasher = Sha256::new();
    std::io::copy(&mut file, &mut hasher).map_err(at(path, "reading"))?;
    Ok(hasher.finalize().iter().fold(String::new(), |mut hex, byte| {
        let _ = write!(hex, "{byte:02x}");
        hex
    }))
}

fn readme(name: &str, utc: &str) -> String {
    format!(
        "{name}\n\
         Differential infrared thermography of a spray, recorded by ditd {version}, begun {utc}.\n\
         \n\
         What lies where\n\
         campaign.toml          the campaign file as run\n\
         journal.jsonl          everything that happened, one JSON object a line; `crc` is the CRC-32 of the line before `,\"crc\"`\n\
         telemetry.csv          every reading of the plate; times in ns since the start, temperatures in K\n\
         frames/levelNN_KIND.npy  raw counts, u16 [frame, row, column], row 0 at the top; NN counts plate levels from 01.\n\
         \x20                      Frames of rejected cycles are in there too: what counts are the `frame` records of\n\
         \x20                      journal.jsonl whose level and cycle have a `cycle-accepted` record\n\
         calibration/           the calibration that was used: calibration.json, flat.npy, and its own run when it was measured here\n\
         result/dit.npz         maps, f64 [row, column]: emissivity, temperature_k, sigma_…, slope, offset, crossing, chi2; count [level, row, column]; flags\n\
         result/dit.exr         the same as f32 channels;  result/temperature_k.tif  for Fiji;  result/*.png  previews with colour bars\n\
         result/report.html     one page for people;  result/summary.json  the same for programs\n\
         world/                 only on a simulated rig: what the simulated world knows of itself (true maps)\n\
         machine.json           wall times and host; not part of any comparison\n\
         manifest-sha256.txt    check with: sha256sum -c manifest-sha256.txt\n\
         \n\
         Pixels without an answer are NaN, and `flags` says why (legend in result/summary.json).\n\
         The temperature is emissivity-weighted and intensity-averaged over the shots (T_eff).\n\
         \n\
         Python\n\
           import numpy as np\n\
           maps = np.load('result/dit.npz'); T = maps['temperature_k']; e = maps['emissivity']\n\
           raw = np.load('frames/level01_spray.npy', mmap_mode='r')\n\
         \n\
         MATLAB\n\
           T = imread('result/temperature_k.tif');\n\
           f = fopen('frames/level01_spray.npy'); fseek(f, 128, 'bof'); raw = fread(f, [columns rows], 'uint16=>double')'; fclose(f);\n\
         \n\
         Fiji/ImageJ\n\
           File > Open… result/temperature_k.tif\n\
           File > Import > Raw… frames/level01_spray.npy: 16-bit unsigned, offset 128, little-endian byte order\n\
         \n\
         Again with ditd\n\
           ditd replay FOLDER      the maps again from the raw frames, compared byte for byte\n\
           ditd fit FOLDER --estimator paper --out OTHER\n",
        version = env!("CARGO_PKG_VERSION"),
    )
}

/// RO-Crate 1.1 metadata: a root dataset and its files.
fn ro_crate(name: &str, utc: &str, files: &[String]) -> String {
    let parts: Vec<serde_json::Value> = files.iter().map(|file| serde_json::json!({ "@id": file })).collect();
    let mut graph = vec![
        serde_json::json!({
            "@id": "ro-crate-metadata.json",
            "@type": "CreativeWork",
            "conformsTo": { "@id": "https://w3id.org/ro/crate/1.1" },
            "about": { "@id": "./" }
        }),
        serde_json::json!({
            "@id": "./",
            "@type": "Dataset",
            "name": name,
            "description": "Differential infrared thermography of a spray: raw frames, journal, calibration, maps",
            "datePublished": utc,
            "license": "All rights reserved by the experimenter unless stated otherwise",
            "hasPart": parts
        }),
    ];
    for file in files {
        graph.push(serde_json::json!({ "@id": file, "@type": "File", "name": file }));
    }
    let document =
        serde_json::json!({ "@context": "https://w3id.org/ro/crate/1.1/context", "@graph": graph });
    let mut text = serde_json::to_string_pretty(&document).expect("plain JSON values");
    text.push('\n');
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sealed_folder_lists_every_file_with_its_sum() {
        let dir = tempfile::tempdir().unwrap();
        let folder = RunFolder::create(&dir.path().join("run")).unwrap();
        folder.write(&folder.campaign(), b"schema = 1\n").unwrap();
        folder.write(&folder.result().join("x.bin"), b"abc").unwrap();
        folder.seal("test", "2026-01-01T00:00:00Z").unwrap();
        let manifest = std::fs::read_to_string(folder.root().join("manifest-sha256.txt")).unwrap();
        // FIPS 180-2, appendix B.1: SHA-256 of "abc".
        assert!(
            manifest
                .contains("ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad  result/x.bin")
        );
        assert_eq!(manifest.lines().count(), 4);
    }

    #[test]
    fn a_folder_with_a_journal_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("journal.jsonl"), b"").unwrap();
        assert!(RunFolder::create(dir.path()).is_err());
    }
}
