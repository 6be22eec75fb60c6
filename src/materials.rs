//! What is known of a fuel, a window material or the lab's air at a temperature and a wavelength, by name or file.
//!
//! Looks things up and lists their values with remarks; prints nothing.

use ditd_sim::fluid::fuel::{FuelProperties, Property};
use ditd_sim::light::air::{self, AirPath, Atmosphere};
use ditd_sim::light::fuel::{self, Fuel};
use ditd_sim::light::names;
use ditd_sim::light::provenance::Provenance;
use ditd_sim::light::window::{self, Material, Plate};
use ditd_sim::scene::library;
use std::path::Path;

/// Lengths of the paths through the air that are printed, in m.
const AIR_LENGTHS_M: [f64; 3] = [0.5, 1.0, 2.0];

/// Thickness of the window whose transmittance is printed, in m.
const WINDOW_M: f64 = 0.01;

/// Something that has optical properties.
#[derive(Debug)]
pub enum Thing {
    /// With its thermophysical properties, where it is a shipped pure fuel.
    Fuel(Box<Fuel>, Option<&'static FuelProperties>),
    /// A material.
    Window(Material),
    /// An atmosphere and its name.
    Air(Atmosphere, &'static str),
}

/// A table: what it holds, range in µm, range in K if there is one, and where it comes from.
pub type Held<'a> = (&'static str, [f64; 2], Option<[f64; 2]>, &'a Provenance);

/// One line of an answer: JSON key, words, value, unit; and why it is to be doubted or missing.
#[derive(Debug, Clone)]
pub struct Line {
    /// Name in JSON.
    pub key: &'static str,
    /// What it is.
    pub words: &'static str,
    /// The value; `None` where it is not known.
    pub value: Option<f64>,
    /// Its unit; empty for ratios.
    pub unit: &'static str,
    /// Why the value is missing or to be doubted; empty otherwise.
    pub remark: String,
}

/// All that is part of the program.
pub fn shipped() -> Vec<Thing> {
    let names = fuel::NAMES.iter().chain(&window::NAMES).copied();
    let names = names.chain(Atmosphere::ALL.iter().map(|own| own.1));
    names.filter_map(|name| find(name).ok()).collect()
}

/// The thing of a name or file.
///
/// # Errors
///
/// Words that name what there is and guess what was meant, or the file and row.
pub fn find(name: &str) -> Result<Thing, String> {
    if fuel::NAMES.contains(&name) {
        let found = Fuel::named(name).map_err(|error| error.to_string())?;
        return Ok(Thing::Fuel(Box::new(found), FuelProperties::named(fuel::pure_name(name))));
    }
    if let Some(atmosphere) = Atmosphere::ALL.iter().find(|own| own.1 == name) {
        return Ok(Thing::Air(atmosphere.0, atmosphere.1));
    }
    let here = Path::new("");
    if name.to_ascii_lowercase().ends_with(".toml") {
        let found = library::fuel(name, here).map_err(|error| error.to_string())?;
        return Ok(Thing::Fuel(Box::new(found), None));
    }
    if Material::named(name).is_some() || library::is_file(name) {
        let found = library::material(name, here).map_err(|error| error.to_string())?;
        return Ok(Thing::Window(found));
    }
    let known: Vec<&str> = fuel::NAMES
        .iter()
        .chain(&window::NAMES)
        .copied()
        .chain(Atmosphere::ALL.iter().map(|own| own.1))
        .collect();
    let guess = names::guess(name, &known).map_or(String::new(), |name| format!(" Did you mean `{name}`?"));
    Err(format!(
        "`{name}` is neither a fuel ({}), nor a window material ({}), nor an atmosphere ({}), nor a file that ends in \
         .toml or .csv.{guess}",
        fuel::NAMES.join(", "),
        window::NAMES.join(", "),
        Atmosphere::ALL.map(|own| own.1).join(", ")
    ))
}

impl Thing {
    /// What it is in a word.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Fuel(..) => "fuel",
            Self::Window(_) => "window",
            Self::Air(..) => "air",
        }
    }

    /// Its name.
    pub fn name(&self) -> &str {
        match self {
            Self::Fuel(fuel, _) => fuel.name(),
            Self::Window(material) => material.table().name(),
            Self::Air(_, name) => name,
        }
    }

    /// Its tables.
    pub fn tables(&self) -> Vec<Held<'_>> {
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

    /// Its values at a wavelength in µm and a temperature in K.
    pub fn lines(&self, wavelength_um: f64, temperature_k: f64) -> Vec<Line> {
        let (um, t) = (wavelength_um, temperature_k);
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
pub fn short(value: f64) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

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
