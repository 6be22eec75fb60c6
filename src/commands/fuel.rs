//! `ditd fuel`: what is known of fuels, window materials and the lab's air, shipped or the user's own, and how well.

use super::{CommandError, CommandResult, print};
use ditd_sim::fluid::fuel::{FuelProperties, Property};
use ditd_sim::light::air::{self, AirPath, Atmosphere};
use ditd_sim::light::fuel::{self, Fuel};
use ditd_sim::light::names;
use ditd_sim::light::provenance::Provenance;
use ditd_sim::light::window::{self, Material, Plate};
use ditd_sim::scene::library;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// Arguments of `ditd fuel`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Fuels, window materials or atmospheres; a file that ends in .toml is a fuel of your own, one that ends in .csv a
    /// window material. Without any, all that is shipped is listed
    #[arg(value_name = "NAME|FILE")]
    names: Vec<String>,
    /// Temperature of liquid, vapour or window, in K
    #[arg(long, value_name = "T", default_value_t = 300.0)]
    temperature_k: f64,
    /// Wavelength, in µm
    #[arg(long, value_name = "L", default_value_t = 3.4)]
    wavelength_um: f64,
    /// Print JSON; what is not known at this temperature is null
    #[arg(long)]
    json: bool,
}

/// Lengths of the paths through the air that are printed, in m.
const AIR_LENGTHS_M: [f64; 3] = [0.5, 1.0, 2.0];

/// Thickness of the window whose transmittance is printed, in m.
const WINDOW_M: f64 = 0.01;

/// Something that has optical properties.
enum Thing {
    /// With its thermophysical properties, where it is a shipped pure fuel.
    Fuel(Box<Fuel>, Option<&'static FuelProperties>),
    Window(Material),
    Air(Atmosphere, &'static str),
}

/// A table: what it holds, range in µm, range in K if there is one, and where it comes from.
type Held<'a> = (&'static str, [f64; 2], Option<[f64; 2]>, &'a Provenance);

/// One line of an answer: JSON key, words, value, unit; and why it is to be doubted or missing.
struct Line {
    key: &'static str,
    words: &'static str,
    value: Option<f64>,
    unit: &'static str,
    remark: String,
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
        args.names.iter().map(|name| find(name)).collect::<Result<_, _>>()?
    };
    if args.json {
        let all: Vec<Value> = things.iter().map(|thing| document(thing, &args, listed)).collect();
        return print(&format!("{:#}\n", Value::Array(all)));
    }
    let texts: Vec<String> =
        things.iter().map(|thing| if listed { summary(thing) } else { answer(thing, &args) }).collect();
    print(&texts.join("\n"))
}

/// All that is part of the program.
fn shipped() -> Vec<Thing> {
    let names = fuel::NAMES.iter().chain(&window::NAMES).copied();
    let names = names.chain(Atmosphere::ALL.iter().map(|own| own.1));
    names.filter_map(|name| find(name).ok()).collect()
}

fn find(name: &str) -> Result<Thing, CommandError> {
    if fuel::NAMES.contains(&name) {
        let found = Fuel::named(name).map_err(|error| CommandError::usage(error.to_string()))?;
        return Ok(Thing::Fuel(Box::new(found), FuelProperties::named(fuel::pure_name(name))));
    }
    if let Some(atmosphere) = Atmosphere::ALL.iter().find(|own| own.1 == name) {
        return Ok(Thing::Air(atmosphere.0, atmosphere.1));
    }
    let here = Path::new("");
    if name.to_ascii_lowercase().ends_with(".toml") {
        let found = library::fuel(name, here).map_err(|error| CommandError::usage(error.to_string()))?;
        return Ok(Thing::Fuel(Box::new(found), None));
    }
    if Material::named(name).is_some() || library::is_file(name) {
        let found = library::material(name, here).map_err(|error| CommandError::usage(error.to_string()))?;
        return Ok(Thing::Window(found));
    }
    let known: Vec<&str> = fuel::NAMES
        .iter()
        .chain(&window::NAMES)
        .copied()
        .chain(Atmosphere::ALL.iter().map(|own| own.1))
        .collect();
    let guess = names::guess(name, &known).map_or(String::new(), |name| format!(" Did you mean `{name}`?"));
    Err(CommandError::usage(format!(
        "`{name}` is neither a fuel ({}), nor a window material ({}), nor an atmosphere ({}), nor a file that ends in \
         .toml or .csv.{guess}",
        fuel::NAMES.join(", "),
        window::NAMES.join(", "),
        Atmosphere::ALL.map(|own| own.1).join(", ")
    )))
}

impl Thing {
    fn kind(&self) -> &'static str {
        match self {
            Self::Fuel(..) => "fuel",
            Self::Window(_) => "window",
            Self::Air(..) => "air",
        }
    }

    fn name(&self) -> &str {
        match self {
            Self::Fuel(fuel, _) => fuel.name(),
            Self::Window(material) => material.table().name(),
            Self::Air(_, name) => name,
        }
    }

    /// Its tables.
    fn tables(&self) -> Vec<Held<'_>> {
        match self {
            Self::Fuel(fuel, _) => vec![
                ("liquid", fuel.liquid_range_um(), Some(fuel.density_range_k()), fuel.liquid_provenance()),
                ("vapour", fuel.vapour_range_um(), Some(fuel.vapour_range_k()), fuel.vapour_provenance()),
            ],
            Self::Window(material) => {
                let table = material.table();
                vec![("index", table.range_um(), table.range_k(), table.provenance())]
            }
            Self::Air(..) => vec![("air", air::range_um(), None, air::provenance())],
        }
    }

    fn lines(&self, args: &Args) -> Vec<Line> {
        let (um, t) = (args.wavelength_um, args.temperature_k);
        match self {
            Self::Fuel(fuel, properties) => fuel_lines(fuel, *properties, um, t),
            Self::Window(material) => window_lines(material, um, t),
            Self::Air(atmosphere, _) => air_lines(*atmosphere, um),
        }
    }
}

fn line(key: &'static str, words: &'static str, value: f64, unit: &'static str) -> Line {
    Line { key, words, value: Some(value), unit, remark: String::new() }
}

/// A remark when `at` lies outside a range whose ends are used there.
fn outside(at: f64, range: [f64; 2], unit: &str, then: &str) -> String {
    if (range[0]..=range[1]).contains(&at) {
        return String::new();
    }
    format!("outside {} to {} {unit}: {then}", short(range[0]), short(range[1]))
}

fn fuel_lines(fuel: &Fuel, properties: Option<&FuelProperties>, um: f64, t: f64) -> Vec<Line> {
    let mut lines = vec![line("molar_mass_kg_mol", "molar mass", fuel.molar_mass_kg_mol(), "kg/mol")];
    if let Some(properties) = properties {
        let constants = properties.constants();
        lines.push(line("boiling_k", "boiling point at 1 atm", constants.boiling_k, "K"));
        lines.push(line("critical_k", "critical temperature", constants.critical_k, "K"));
        lines.push(line("critical_pa", "critical pressure", constants.critical_pa, "Pa"));
    }
    let density = line("rho_liq_kg_m3", "density of the liquid", fuel.liquid_density(t), "kg/m3");
    let remark = outside(t, fuel.density_range_k(), "K", "continued or held, for the index only");
    lines.push(Line { remark, ..density });
    if let Some(properties) = properties {
        for (property, key, words) in Property::ALL {
            if property == Property::LiquidDensity {
                continue;
            }
            let (value, remark) = match properties.at(property, t) {
                Ok(value) => (Some(value), String::new()),
                Err(_) => {
                    let [from, to] = properties.correlation(property).range_k;
                    (None, format!("known from {from} to {to} K"))
                }
            };
            let key = if property == Property::DiffusivityAt1Bar { "D_in_N2_at_1bar_m2_s" } else { key };
            lines.push(Line { key, words, value, unit: unit(property), remark });
        }
    }
    let (n, k) = fuel.liquid_index(um, t);
    let remark = outside(um, fuel.liquid_range_um(), "um", "the end is used");
    lines.push(Line { remark: remark.clone(), ..line("n", "index of the liquid, n", n, "") });
    lines.push(Line { remark, ..line("k", "index of the liquid, k", k, "") });
    let section = fuel.vapour_cross_section_m2_mol(um, t);
    let outside_band = outside(um, fuel.vapour_range_um(), "um", "0");
    let remark = if outside_band.is_empty() {
        outside(t, fuel.vapour_range_k(), "K", "the end is used")
    } else {
        outside_band
    };
    let section = line("sigma_m2_mol", "cross-section of the vapour", section, "m2/mol");
    lines.push(Line { remark, ..section });
    lines
}

fn unit(property: Property) -> &'static str {
    match property {
        Property::VapourPressure => "Pa",
        Property::LiquidDensity => "kg/m3",
        Property::LiquidHeatCapacity | Property::VapourHeatCapacity => "J/(kg K)",
        Property::HeatOfVaporisation => "J/kg",
        Property::SurfaceTension => "N/m",
        Property::LiquidViscosity | Property::VapourViscosity => "Pa s",
        Property::LiquidConductivity | Property::VapourConductivity => "W/(m K)",
        Property::DiffusivityAt1Bar => "m2/s",
    }
}

fn window_lines(material: &Material, um: f64, t: f64) -> Vec<Line> {
    let table = material.table();
    let (n, k) = material.index(um, t);
    let plate = Plate { material: material.clone(), thickness_m: WINDOW_M }.optics(um, t);
    let beyond = outside(um, table.range_um(), "um", "the end is used");
    let warm = table.range_k().map_or(String::new(), |range| outside(t, range, "K", "the end is used"));
    let absorption = if table.absorbs() { beyond.clone() } else { "absorption neglected".to_owned() };
    vec![
        Line { remark: if beyond.is_empty() { warm } else { beyond }, ..line("n", "index, n", n, "") },
        Line { remark: absorption, ..line("k", "index, k", k, "") },
        line("transmittance_10mm", "transmittance of 10 mm", plate.transmittance, ""),
        line("reflectance_10mm", "reflectance of 10 mm", plate.reflectance, ""),
        line("absorptance_10mm", "absorptance of 10 mm", plate.absorptance, ""),
    ]
}

fn air_lines(atmosphere: Atmosphere, um: f64) -> Vec<Line> {
    let keys = ["transmittance_0.5m", "transmittance_1m", "transmittance_2m"];
    let words = ["transmittance of 0.5 m", "transmittance of 1 m", "transmittance of 2 m"];
    let remark = outside(um, air::range_um(), "um", "the end is used");
    let lines = AIR_LENGTHS_M.iter().zip(keys.into_iter().zip(words));
    lines
        .filter_map(|(&length_m, (key, words))| {
            let path = AirPath::new(atmosphere, length_m).ok()?;
            Some(Line { remark: remark.clone(), ..line(key, words, path.transmittance(um), "") })
        })
        .collect()
}

/// A number with six significant digits, without needless zeros.
fn short(value: f64) -> String {
    let mut size = value.abs();
    if value != 0.0 && !(1e-3..1e7).contains(&size) {
        return format!("{value:.5e}");
    }
    let mut decimals = 5usize;
    while size >= 10.0 && decimals > 0 {
        size /= 10.0;
        decimals -= 1;
    }
    while size < 1.0 && decimals < 8 {
        size *= 10.0;
        decimals += 1;
    }
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
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
    for line in thing.lines(args) {
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
        let values = thing.lines(args).into_iter().map(|line| (line.key.to_owned(), json!(line.value)));
        let remarks = thing.lines(args).into_iter().filter(|line| !line.remark.is_empty());
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
        assert!(error.code == 2 && error.message.contains("Did you mean `n-heptane`?"), "{}", error.message);
        assert!(find("missing.toml").err().unwrap().message.contains("missing.toml: reading the file"));
        assert!(find("missing.csv").err().unwrap().message.contains("missing.csv: reading the file"));
    }

    #[test]
    fn numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (300.0, "300"),
            (0.100_201_94, "0.100202"),
            (2_735_730.0, "2735730"),
            (1.234_567_8e-6, "1.23457e-6"),
            (-3.4, "-3.4"),
            (999_999.5, "1000000"),
        ] {
            assert_eq!(short(value), text);
        }
    }
}
