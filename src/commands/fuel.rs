//! `ditd fuel`: what is known of fuels, window materials and the lab's air, shipped or the user's own, and how well.

use super::{CommandError, CommandResult, print};
use crate::materials::{Thing, find, shipped, short};
use ditd_sim::fluid::fuel::FuelProperties;
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Arguments of `ditd fuel`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Fuels, window materials or atmospheres; a file that ends in .toml is a fuel of your own, one that ends in .csv a
    /// window material. Without any, all that is shipped is listed
    #[arg(value_name = "NAME|FILE")]
    names: Vec<String>,
    /// Temperature of liquid, vapour or window, in K
    #[arg(long, value_name = "T", allow_negative_numbers = true, default_value_t = 300.0)]
    temperature_k: f64,
    /// Wavelength, in µm
    #[arg(long, value_name = "L", allow_negative_numbers = true, default_value_t = 3.4)]
    wavelength_um: f64,
    /// Print JSON; what is not known at this temperature is null
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
///
/// Status 2 for a name or file that cannot be used, a temperature or a wavelength that is not possible.
pub fn run(args: Args) -> CommandResult {
    for (name, value) in [("--temperature-k", args.temperature_k), ("--wavelength-um", args.wavelength_um)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(CommandError::usage(format!("{name} {value}: it must be finite and above 0")));
        }
    }
    let listed = args.names.is_empty();
    let things = if listed {
        shipped()
    } else {
        args.names.iter().map(|name| find(name).map_err(CommandError::usage)).collect::<Result<_, _>>()?
    };
    if args.json {
        let all: Vec<Value> = things.iter().map(|thing| document(thing, &args, listed)).collect();
        return print(&format!("{:#}\n", Value::Array(all)));
    }
    let texts: Vec<String> =
        things.iter().map(|thing| if listed { summary(thing) } else { answer(thing, &args) }).collect();
    print(&texts.join("\n"))
}

/// Name, ranges and sources.
fn summary(thing: &Thing) -> String {
    let mut out = format!("{} ({})\n", thing.name(), thing.kind());
    for (what, um, kelvin, provenance) in thing.tables() {
        let status = provenance.status.map_or("not stated".to_owned(), |status| status.to_string());
        let kelvin =
            kelvin.map_or(String::new(), |range| format!(", {} to {} K", short(range[0]), short(range[1])));
        // Writing to a String cannot fail.
        let _ = writeln!(out, "  {what:<7} {status:<10} {:.3} to {:.3} um{kelvin}", um[0], um[1]);
        let source = if provenance.source.is_empty() { "source not stated" } else { &provenance.source };
        let _ = writeln!(out, "          {source}");
        if !provenance.uncertainty.is_empty() {
            let _ = writeln!(out, "          uncertainty: {}", provenance.uncertainty);
        }
    }
    out
}

/// Properties at a temperature and a wavelength, then ranges and sources.
fn answer(thing: &Thing, args: &Args) -> String {
    let at = match thing {
        Thing::Air(..) => format!("{} um", short(args.wavelength_um)),
        _ => format!("{} K, {} um", short(args.temperature_k), short(args.wavelength_um)),
    };
    let mut out = format!("{} at {at}\n", thing.name());
    for line in thing.lines(args.wavelength_um, args.temperature_k) {
        let value = line.value.map_or("-".to_owned(), short);
        let remark = if line.remark.is_empty() { String::new() } else { format!("({})", line.remark) };
        let text = format!("  {:<34} {value:>12} {:<9} {remark}", line.words, line.unit);
        let _ = writeln!(out, "{}", text.trim_end());
    }
    out.push_str(&summary(thing));
    if let Thing::Fuel(_, Some(_)) = thing {
        let _ = writeln!(out, "  other properties: {}", FuelProperties::provenance());
    }
    out
}

fn document(thing: &Thing, args: &Args, listed: bool) -> Value {
    let tables: serde_json::Map<String, Value> = thing
        .tables()
        .into_iter()
        .map(|(what, um, kelvin, provenance)| {
            let table = json!({
                "status": provenance.status.map(|status| status.to_string()),
                "source": provenance.source,
                "uncertainty": provenance.uncertainty,
                "licence": provenance.licence,
                "range_um": um,
                "range_k": kelvin,
            });
            (what.to_owned(), table)
        })
        .collect();
    let mut document = json!({ "name": thing.name(), "kind": thing.kind(), "tables": tables });
    if !listed {
        let values = thing
            .lines(args.wavelength_um, args.temperature_k)
            .into_iter()
            .map(|line| (line.key.to_owned(), json!(line.value)));
        let remarks = thing
            .lines(args.wavelength_um, args.temperature_k)
            .into_iter()
            .filter(|line| !line.remark.is_empty());
        document["temperature_k"] = json!(args.temperature_k);
        document["wavelength_um"] = json!(args.wavelength_um);
        document["values"] = Value::Object(values.collect());
        document["remarks"] =
            Value::Object(remarks.map(|line| (line.key.to_owned(), json!(line.remark))).collect());
    }
    document
}

#[cfg(test)]
mod tests {
    use super::*;
    use ditd_sim::light::air::Atmosphere;
    use ditd_sim::light::{fuel, window};

    fn args(temperature_k: f64, wavelength_um: f64) -> Args {
        Args { names: vec![], temperature_k, wavelength_um, json: false }
    }

    #[test]
    fn all_that_is_shipped_is_listed_with_status_and_source() {
        let things = shipped();
        assert_eq!(things.len(), fuel::NAMES.len() + window::NAMES.len() + Atmosphere::ALL.len());
        for thing in &things {
            let text = summary(thing);
            assert!(!text.contains("not stated") && text.contains("uncertainty"), "{text}");
            let document = document(thing, &args(300.0, 3.4), true);
            assert!(
                document["tables"].as_object().unwrap().values().all(|table| table["status"].is_string())
            );
        }
    }

    #[test]
    fn values_are_those_of_the_library_and_what_is_not_known_is_null() {
        let heptane = find("n-heptane").unwrap();
        let value = |t: f64, um: f64| document(&heptane, &args(t, um), false);
        let at = value(383.0, 3.419);
        // 1.4 bar at 383 K; k max 0.159 at 299 K, less in the thinner liquid.
        assert!((at["values"]["p_sat_Pa"].as_f64().unwrap() - 1.4e5).abs() < 5e3);
        assert!((0.12..0.159).contains(&at["values"]["k"].as_f64().unwrap()));
        assert!(at["remarks"].as_object().unwrap().is_empty(), "{at:#}");
        let hot = value(600.0, 2.0);
        assert!(hot["values"]["p_sat_Pa"].is_null() && hot["values"]["cp_ideal_gas_J_kgK"].is_f64());
        for key in ["p_sat_Pa", "rho_liq_kg_m3", "n", "sigma_m2_mol"] {
            assert!(hot["remarks"][key].is_string(), "{key}: {hot:#}");
        }
        let text = answer(&heptane, &args(600.0, 3.4));
        assert!(text.contains("known from 280 to 485 K"), "{text}");
    }

    #[test]
    fn windows_and_air_are_known_by_name_and_slips_are_recognised() {
        let caf2 = document(&find("caf2").unwrap(), &args(297.0, 3.4), false);
        // optics.md: 0.9427 at 297 K.
        assert!((caf2["values"]["transmittance_10mm"].as_f64().unwrap() - 0.9427).abs() < 1e-4);
        let air = document(&find("us-standard").unwrap(), &args(297.0, 3.4), false);
        assert!(air["values"]["transmittance_2m"].as_f64() < air["values"]["transmittance_1m"].as_f64());
        let error = find("n-heptan").err().unwrap();
        assert!(error.contains("Did you mean `n-heptane`?"), "{error}");
        assert!(find("missing.toml").err().unwrap().contains("missing.toml: reading the file"));
        assert!(find("missing.csv").err().unwrap().contains("missing.csv: reading the file"));
    }
}
