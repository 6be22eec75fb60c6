//! Campaign files that are part of the program, so that it runs the quickstart from any folder.

use std::path::{Path, PathBuf};

/// Name and text of each embedded campaign file.
pub const SAMPLES: [(&str, &str); 2] = [
    ("quickstart", include_str!("../configs/quickstart.toml")),
    ("long", include_str!("../configs/long.toml")),
];

/// A campaign file's text and how messages call it.
#[derive(Debug, Clone)]
pub struct Source {
    /// As the user wrote it.
    pub name: String,
    /// The text.
    pub text: String,
    /// Folder that relative file names start from.
    pub folder: PathBuf,
}

/// Reads a campaign file; when there is none of that name, `quickstart`, `quickstart.toml` and
/// `configs/quickstart.toml` mean the embedded one.
///
/// # Errors
///
/// Words that name the file and what to try.
pub fn open(path: &Path) -> Result<Source, String> {
    let name = path.display().to_string();
    let folder = path.parent().map(Path::to_owned).unwrap_or_default();
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(Source { name, text, folder }),
        Err(error) => {
            let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
            let plain =
                [stem.clone(), format!("{stem}.toml"), format!("configs/{stem}.toml")].contains(&name);
            let embedded = SAMPLES.iter().find(|(sample, _)| plain && *sample == stem);
            match embedded {
                Some((_, text)) if error.kind() == std::io::ErrorKind::NotFound => {
                    Ok(Source { name, text: (*text).to_owned(), folder })
                }
                _ => Err(format!(
                    "{name}: reading the campaign file: {error}. Built in are: {}.",
                    SAMPLES.map(|(sample, _)| sample).join(", ")
                )),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quickstart_is_there_without_any_file() {
        for name in ["quickstart", "quickstart.toml"] {
            assert!(open(Path::new(name)).unwrap().text.contains("[campaign]"));
        }
        let error = open(Path::new("nowhere/quickstart.toml")).unwrap_err();
        assert!(error.contains("nowhere/quickstart.toml"), "{error}");
    }
}
