//! `ditd check`: the plan, its time, bytes and limits. Touches no instrument.

use super::{CommandError, CommandResult, load, print};
use crate::config::Config;
use crate::console::duration_words;
use crate::expectation;
use crate::plan::{Cost, Plan};
use crate::rigs;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Arguments of `ditd check`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Campaign file, or the name of a built-in one (quickstart, long)
    config: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
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
