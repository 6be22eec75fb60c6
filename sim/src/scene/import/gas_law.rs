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

/// Which of several field names is the fuel.
pub(super) fn find_fuel(names: &[String]) -> Result<String, String> {
    let mut fuels: Vec<&String> = names.iter().filter(|n| fuel_molar_mass(n).is_some()).collect();
    fuels.sort();
    fuels.dedup();
    match fuels.as_slice() {
        [one] => return Ok((*one).clone()),
        [] => {}
        several => {
            let list = several.iter().map(|s| s.as_str()).collect::<Vec<_>>().join(", ");
            return Err(format!("several fuels: {list}; name the one to use"));
        }
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
        [one] => Ok((*one).clone()),
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
        assert_eq!(find_fuel(&names(&["T", "p", "C7H16", "N2"])).as_deref(), Ok("C7H16"));
        assert_eq!(find_fuel(&names(&["T", "p", "gasoline"])).as_deref(), Ok("gasoline"));
        assert!(find_fuel(&names(&["C7H16", "C8H18"])).unwrap_err().contains("C7H16, C8H18"));
    }

    #[test]
    fn density_and_pressure_are_inverse() {
        let mixture = Mixture { fuel: 0.1, carrier: NITROGEN_KG_MOL };
        let density = mixture.density(4e5, 450.0, 0.2);
        assert!((mixture.pressure(density, 450.0, 0.2) / 4e5 - 1.0).abs() < 1e-14);
    }
}
