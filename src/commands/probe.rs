//! `ditd probe`: what a GenICam camera offers, feature by feature. Reads only.

#[cfg(not(feature = "aravis"))]
use super::CommandError;
use super::CommandResult;

/// Print every feature of a GenICam camera: kind, value, range, choices
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The camera's network address, as `ditd devices` lists it
    address: String,
    /// Only features whose name or category contains this
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
///
/// Status 3 when no camera answers there; status 1 in a program that was built without GigE cameras.
#[cfg(feature = "aravis")]
pub fn run(args: Args) -> CommandResult {
    use super::{CommandError, print};
    let offered = ditd_drivers::gige::probe::probe(&args.address)
        .map_err(|error| CommandError { code: 3, message: error.to_string() })?;
    let wanted = args.only.unwrap_or_default().to_lowercase();
    let chosen: Vec<_> = offered
        .into_iter()
        .filter(|f| f.name.to_lowercase().contains(&wanted) || f.category.to_lowercase().contains(&wanted))
        .collect();
    if args.json {
        let text = serde_json::to_string_pretty(&chosen)
            .map_err(|error| CommandError::failure(error.to_string()))?;
        return print(&format!("{text}\n"));
    }
    let mut out = String::new();
    let mut category = String::new();
    for f in &chosen {
        if f.category != category {
            category.clone_from(&f.category);
            out.push_str(&format!("{category}\n"));
        }
        let value = f.value.as_deref().unwrap_or(if f.kind == "command" { "" } else { "not readable now" });
        let unit = f.unit.as_ref().map(|unit| format!(" {unit}")).unwrap_or_default();
        let range = f.range.map(|(low, high)| format!("  {low} to {high}")).unwrap_or_default();
        let choices =
            if f.choices.is_empty() { String::new() } else { format!("  {}", f.choices.join(" | ")) };
        let access = if f.writable { "" } else { "  (read only)" };
        out.push_str(&format!("  {:<32} {:<11} {value}{unit}{range}{choices}{access}\n", f.name, f.kind));
    }
    print(&out)
}

/// Says what is missing.
///
/// # Errors
///
/// Always status 1.
#[cfg(not(feature = "aravis"))]
pub fn run(args: Args) -> CommandResult {
    let Args { address, only: _, json: _ } = args;
    Err(CommandError::failure(format!(
        "camera at {address}: probing it: {}.",
        ditd_drivers::gige::WITHOUT_ARAVIS
    )))
}
