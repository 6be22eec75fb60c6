//! The ideal mixture of fuel vapour and one other gas, and the molar masses of fuels by name.

use super::super::field::GAS_CONSTANT;

/// Molar mass of nitrogen in kg/mol (2 × 14.0067, as the CFD codes seen have it).
pub const NITROGEN_KG_MOL: f64 = 0.028_013_4;

/// Molar masses of the two partners in kg/mol.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mixture {
    pub(super) fuel: f64,
    pub(super) carrier: f64,
}

impl Mixture {
    /// ρ = p M / (R T) with 1/M = Y/M_fuel + (1 − Y)/M_carrier; agrees with the density that OpenFOAM writes to 1.4e-6.
    pub(super) fn density(&self, pressure_pa: f64, temperature_k: f64, fuel_mass_fraction: f64) -> f64 {
        pressure_pa / (GAS_CONSTANT * temperature_k * self.moles_per_kg(fuel_mass_fraction))
    }

    /// The same, solved for the pressure.
    pub(super) fn pressure(&self, density_kg_m3: f64, temperature_k: f64, fuel_mass_fraction: f64) -> f64 {
        density_kg_m3 * GAS_CONSTANT * temperature_k * self.moles_per_kg(fuel_mass_fraction)
    }

    fn moles_per_kg(&self, fuel_mass_fraction: f64) -> f64 {
        fuel_mass_fraction / self.fuel + (1.0 - fuel_mass_fraction) / self.carrier
    }
}

/// Molar mass in kg/mol of a fuel by its name in the CFD code: a formula of C, H, O and N, perhaps with `i` or
/// `n` before it (`C7H16`, `IC8H18`, `nC7H16`, `C2H5OH`), or a common name. `None` if the name is neither.
pub fn fuel_molar_mass(name: &str) -> Option<f64> {
    let common = match name.to_ascii_lowercase().as_str() {
        "heptane" | "n-heptane" | "nheptane" => "C7H16",
        "isooctane" | "iso-octane" | "iso_octane" | "octane" => "C8H18",
        "ethanol" => "C2H6O",
        "methanol" => "CH4O",
        "hexane" | "n-hexane" => "C6H14",
        "pentane" | "n-pentane" => "C5H12",
        "decane" | "n-decane" => "C10H22",
        "dodecane" | "n-dodecane" => "C12H26",
        _ => name,
    };
    let plain = common.trim_start_matches(['i', 'n', '-', 'I']);
    // `NC7H16` is n-heptane: no fuel begins with nitrogen.
    formula(plain.strip_prefix('N').unwrap_or(plain))
}

/// Sum of atomic masses (IUPAC 2007) if carbon and hydrogen are in it. C7H16 gives 0.100204 kg/mol, the value of
/// the sprays seen; tables that round otherwise differ by 1e-5.
fn formula(text: &str) -> Option<f64> {
    let mut rest = text.as_bytes();
    let mut grams = 0.0;
    let (mut carbon, mut hydrogen) = (false, false);
    while let Some((&element, after)) = rest.split_first() {
        let mass = match element {
            b'C' | b'c' => 12.011,
            b'H' | b'h' => 1.007_94,
            b'O' | b'o' => 15.999_4,
            b'N' | b'n' => 14.006_7,
            _ => return None,
        };
        carbon |= element.eq_ignore_ascii_case(&b'C');
        hydrogen |= element.eq_ignore_ascii_case(&b'H');
        let digits = after.iter().take_while(|b| b.is_ascii_digit()).count();
        let number: u16 =
            if digits == 0 { 1 } else { std::str::from_utf8(&after[..digits]).ok()?.parse().ok()? };
        grams += mass * f64::from(number);
        rest = &after[digits..];
    }
    (carbon && hydrogen).then_some(grams * 1e-3)
}

/// The fuel's field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct FuelName {
    pub(super) name: String,
    /// What the user should know about the choice.
    pub(super) note: Option<String>,
}

/// Which of several field names is the fuel; `liquids` are what the droplets are said to be made of.
pub(super) fn find_fuel(names: &[String], liquids: &[String]) -> Result<FuelName, String> {
    let mut fuels: Vec<&String> = names.iter().filter(|n| fuel_molar_mass(n).is_some()).collect();
    fuels.sort();
    fuels.dedup();
    let listed = |names: &[&String]| names.iter().map(|s| s.as_str()).collect::<Vec<_>>().join(", ");
    let mut of_droplets: Vec<&String> = names.iter().filter(|n| liquids.contains(n)).collect();
    of_droplets.sort();
    of_droplets.dedup();
    match (fuels.as_slice(), of_droplets.as_slice()) {
        ([one], _) if liquids.is_empty() || liquids.contains(one) => {
            return Ok(FuelName { name: (*one).clone(), note: None });
        }
        (fuels, [one]) => {
            let others: Vec<&String> = fuels.iter().copied().filter(|f| f != one).collect();
            let note = (!others.is_empty())
                .then(|| format!("fuel {one}: the droplets are made of it; not read: {}", listed(&others)));
            return Ok(FuelName { name: (*one).clone(), note });
        }
        ([one], _) => return Ok(FuelName { name: (*one).clone(), note: None }),
        ([], _) => {}
        (several, _) => return Err(format!("several fuels: {}; name the one to use", listed(several))),
    }
    // Names of the other fields of the solvers seen or documented; what is left may be a fuel under another name.
    const OTHERS: &[&str] = &[
        "T",
        "p",
        "p_rgh",
        "rho",
        "U",
        "phi",
        "k",
        "epsilon",
        "omega",
        "nut",
        "mut",
        "alphat",
        "psi",
        "G",
        "Qdot",
        "dQ",
        "N2",
        "O2",
        "H2O",
        "CO2",
        "CO",
        "AR",
        "Ar",
        "He",
        "NO",
        "Ydefault",
        "cellID",
        "meshPhi",
        "Phi",
        "h",
        "Ma",
        "mu",
        "V",
        "active",
        "cellToRegion",
    ];
    let mut left: Vec<&String> = names.iter().filter(|n| !OTHERS.contains(&n.as_str())).collect();
    left.dedup();
    match left.as_slice() {
        [one] => Ok(FuelName {
            name: (*one).clone(),
            note: Some(format!("fuel {one}: the only field that is nothing else")),
        }),
        _ => Err(format!("no fuel among the fields {}; name it", names.join(", "))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fuels_are_known_by_their_formula() {
        for (name, grams) in [
            ("C7H16", 100.204),
            ("IC8H18", 114.231),
            ("nC7H16", 100.204),
            ("C2H5OH", 46.069),
            ("NC7H16", 100.204),
        ] {
            let mass = fuel_molar_mass(name).unwrap();
            assert!((1e3 * mass - grams).abs() < 1e-3, "{name}: {mass}");
        }
        for name in ["T", "p", "rho", "CO2", "H2O", "N2", "k", "c0d", "OH"] {
            assert_eq!(fuel_molar_mass(name), None, "{name}");
        }
    }

    #[test]
    fn the_fuel_is_found_or_the_choice_is_named() {
        let names = |list: &[&str]| list.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>();
        let found =
            |list: &[&str], liquids: &[&str]| find_fuel(&names(list), &names(liquids)).map(|f| f.name);
        assert_eq!(found(&["T", "p", "C7H16", "N2"], &[]).as_deref(), Ok("C7H16"));
        assert_eq!(found(&["T", "p", "gasoline"], &[]).as_deref(), Ok("gasoline"));
        assert!(found(&["C7H16", "C8H18"], &[]).unwrap_err().contains("C7H16, C8H18"));
        assert!(found(&["C7H16", "C8H18"], &["C7H16", "C8H18"]).unwrap_err().contains("C7H16, C8H18"));
        assert_eq!(found(&["CH4", "IDEA", "T"], &["IDEA"]).as_deref(), Ok("IDEA"));
        assert_eq!(found(&["C7H16", "CH4", "T"], &["C7H16", "H2O"]).as_deref(), Ok("C7H16"));
    }

    #[test]
    fn density_and_pressure_are_inverse() {
        let mixture = Mixture { fuel: 0.1, carrier: NITROGEN_KG_MOL };
        let density = mixture.density(4e5, 450.0, 0.2);
        assert!((mixture.pressure(density, 450.0, 0.2) / 4e5 - 1.0).abs() < 1e-14);
    }
}
