//! `ditd check`: the plan, its time, bytes and limits. Touches no instrument.

use super::{CommandError, CommandResult, load, print};
use crate::config::Config;
use crate::console::duration_words;
use crate::expectation;
use crate::plan::{Cost, Plan};
use crate::report::plot::timing::Timing;
use crate::rigs;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Arguments of `ditd check`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Campaign file, or the name of a built-in one (quickstart, long)
    config: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Draw the pulses of one cycle into an SVG file, to be laid beside an oscilloscope's screen
    #[arg(long, value_name = "FILE.svg")]
    timing: Option<PathBuf>,
}

/// Validates a campaign file and prints what it would do.
///
/// # Errors
///
/// Status 2 when the file cannot be used.
pub fn run(args: Args) -> CommandResult {
    let (source, config) = load(&args.config)?;
    rigs::own_files(&config, &source.folder).map_err(|error| CommandError::usage(error.to_string()))?;
    let plan = Plan::of_map(&config);
    if let Some(path) = &args.timing {
        draw_timing(&config, &plan, path)?;
    }
    let cost = plan.cost(&config);
    let curve = (config.optics.calibration == "measure").then(|| Plan::of_standard_curve(&config)).flatten();
    let expected = expectation::of(&config, &plan, &source.folder);
    if args.json {
        let document = serde_json::json!({
            "name": config.campaign.name,
            "plan": plan,
            "cost": cost,
            "expected": expected,
            "calibration": curve.as_ref().map(|plan| serde_json::json!({ "plan": plan, "cost": plan.cost(&config) })),
        });
        return print(&format!("{document:#}\n"));
    }
    let expected = expected.map_or_else(
        || {
            "\nExpected σ of T: not known before the calibration (optics.calibration is \"measure\").\n"
                .to_owned()
        },
        |expected| expected.words(),
    );
    print(&(words(&config, &plan, &cost, curve.as_ref()) + &expected))
}

/// All levels of a plan have the same program: the first one's is drawn.
fn draw_timing(config: &Config, plan: &Plan, path: &Path) -> Result<(), CommandError> {
    let is_svg = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("svg"));
    if !is_svg {
        let message = format!("--timing {}: the drawing is an SVG file: name it so", path.display());
        return Err(CommandError::usage(message));
    }
    let Some(level) = plan.levels.first() else { return Ok(()) };
    let drawing = Timing {
        title: &config.campaign.name,
        program: &level.program,
        integration_s: config.camera.integration_s,
        readout_s: config.camera.readout_s,
    };
    std::fs::write(path, drawing.to_svg())
        .map_err(|error| CommandError::failure(format!("--timing {}: {error}", path.display())))
}

fn words(config: &Config, plan: &Plan, cost: &Cost, curve: Option<&Plan>) -> String {
    let mut out = format!("{}\n\n", config.campaign.name);
    let rig = if config.is_simulated() { "simulated" } else { "real" };
    // Writing to a String cannot fail.
    let _ = writeln!(
        out,
        "rig       {rig}: plate {} at {}, trigger {} at {}, camera {} at {}",
        config.plate.driver,
        config.plate.address,
        config.trigger.driver,
        config.trigger.address,
        config.camera.driver,
        config.camera.address
    );
    let _ = writeln!(
        out,
        "limits    plate {:.1} K, injector pulse {} ms, injections at least {} s apart",
        config.plate.limit_k,
        config.trigger.injection_limit_s * 1e3,
        config.trigger.injection_interval_limit_s
    );
    if let Some(curve) = curve {
        out.push_str("\nFirst the standard curve, without chamber and injector:\n");
        out.push_str(&curve.describe());
        costs(&mut out, &curve.cost(config));
    }
    out.push_str("\nThe campaign:\n");
    out.push_str(&plan.describe());
    costs(&mut out, cost);
    out
}

fn costs(out: &mut String, cost: &Cost) {
    let _ = writeln!(
        out,
        "time      about {} ({} settling, {} in cycles); {} injections",
        duration_words(cost.soak_s + cost.cycles_s),
        duration_words(cost.soak_s),
        duration_words(cost.cycles_s),
        cost.injections
    );
    let _ = writeln!(out, "bytes     {:.1} MB in {} raw frames", cost.bytes as f64 * 1e-6, cost.frames);
}
