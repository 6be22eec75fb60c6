//! `ditd replay`: a recorded run through the live path again, compared byte for byte.

use super::{CommandError, CommandResult, print};
use crate::session;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Arguments of `ditd replay`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Run folder
    folder: PathBuf,
    /// Folder to write `result/` into; a temporary one without it
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Replays a run.
///
/// # Errors
///
/// Status 5 when the results differ or the record is damaged.
pub fn run(args: Args) -> CommandResult {
    let temporary = args.out.is_none();
    let out =
        args.out.unwrap_or_else(|| std::env::temp_dir().join(format!("ditd-replay-{}", std::process::id())));
    let result = out.join("result");
    let replayed = session::replay(&args.folder, &result, None);
    let compared = replayed.map_err(CommandError::from).and_then(|words| {
        let files = compare(&args.folder.join("result"), &result)?;
        Ok(if args.json {
            format!("{:#}\n", serde_json::json!({ "equal": true, "files": files }))
        } else {
            format!("{words}replay    {} files, equal byte for byte\n", files.len())
        })
    });
    if temporary {
        // What was only made for the comparison; a leftover would do no harm.
        let _ = std::fs::remove_dir_all(&out);
    }
    print(&compared?)
}

/// Names of the plain files of a folder, sorted.
fn names(folder: &Path) -> Result<Vec<String>, CommandError> {
    let failed = |error: std::io::Error| {
        CommandError::failure(format!(
            "{}: {error}. A run that has not ended has no result: `ditd resume` it first.",
            folder.display()
        ))
    };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        found.push(entry.map_err(failed)?.file_name().to_string_lossy().into_owned());
    }
    found.sort();
    Ok(found)
}

/// Compares two result folders: the names of the equal files, or status 5 with the list of differences.
fn compare(recorded: &Path, replayed: &Path) -> Result<Vec<String>, CommandError> {
    let (old, new) = (names(recorded)?, names(replayed)?);
    let mut differences = String::new();
    for name in old.iter().chain(new.iter().filter(|name| !old.contains(name))) {
        let why = match (std::fs::read(recorded.join(name)), std::fs::read(replayed.join(name))) {
            (Ok(old), Ok(new)) if old == new => continue,
            (Ok(old), Ok(new)) => {
                let at = old.iter().zip(&new).take_while(|(a, b)| a == b).count();
                format!("differs from byte {at} on ({} and {} bytes)", old.len(), new.len())
            }
            (Err(error), _) => format!("recorded: {error}"),
            (_, Err(error)) => format!("replayed: {error}"),
        };
        // Writing to a String cannot fail.
        let _ = writeln!(differences, "  {name}: {why}");
    }
    if differences.is_empty() {
        return Ok(old);
    }
    Err(CommandError {
        code: 5,
        message: format!(
            "replay: the results differ from {}:\n{differences}Either the record was changed or another version of ditd made it.",
            recorded.display()
        ),
    })
}
