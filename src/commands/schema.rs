//! `ditd schema`: the JSON schema of the campaign file.

use super::{CommandError, CommandResult, print};
use crate::config::Config;

/// Prints the schema.
///
/// # Errors
///
/// When standard output refuses.
pub fn run() -> CommandResult {
    let schema = schemars::schema_for!(Config);
    let text =
        serde_json::to_string_pretty(&schema).map_err(|error| CommandError::failure(error.to_string()))?;
    print(&format!("{text}\n"))
}
