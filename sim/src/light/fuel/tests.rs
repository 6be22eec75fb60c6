//! What every fuel obeys: limits in wavelength and temperature, conservation of the molar response, refusals.

use super::*;

#[test]
fn the_liquid_at_its_reference_temperature_is_the_table() {
    // optics.md: n-heptane k max 0.159 at 3.419 um, 0.124 at 3.380, 0.069 at 3.400.
    let fuel = Fuel::named("n-heptane").unwrap();
    for (lam, k) in [(3.419, 0.159), (3.380, 0.124), (3.400, 0.069)] {
        assert!((fuel.liquid_index(lam, LIQUID_REFERENCE_K).1 - k).abs() < 1e-3, "{lam}");
    }
    let table = Table::parse(include_str!("../../../data/optics/liquid_n-octane_nk_measured.csv")).unwrap();
    let fuel = Fuel::named("n-octane").unwrap();
    for row in (0..table.names().len() * 100).step_by(7) {
        let at = |name| table.column(name).unwrap()[row];
        let (n, k) = fuel.liquid_index(1e4 / at("wavenumber_cm-1"), LIQUID_REFERENCE_K);
        // The same number through Lorentz-Lorenz and back: rounding only.
        assert!((n - at("n")).abs() < 1e-14 && (k - at("k")).abs() < 1e-14, "row {row}");
    }
}

#[test]
fn molar_response_is_kept_when_the_liquid_expands() {
    let fuel = Fuel::named("n-heptane").unwrap();
    let response = |t: f64| {
        let (n, k) = fuel.liquid_index(3.42, t);
        let a = lorentz_lorenz(Complex::new(n, k));
        a * (fuel.molar_mass_kg_mol() / fuel.liquid_density(t))
    };
    let (cold, warm) = (response(299.15), response(400.0));
    assert!((cold - warm).abs() < 1e-14 * cold.abs() * 10.0);
}

#[test]
fn vapour_absorbs_in_its_band_only_and_keeps_the_ends_of_its_temperatures() {
    let fuel = Fuel::named("n-heptane").unwrap();
    // optics.md: 46 m2/mol at 3.39 um and 300 K.
    assert!((fuel.vapour_cross_section_m2_mol(1e4 / 2947.9, 300.0) - 46.0).abs() < 1.0);
    let [from, to] = fuel.vapour_range_um();
    for lam in [2.5, from - 1e-6, to + 1e-6, 4.3] {
        assert_eq!(fuel.vapour_cross_section_m2_mol(lam, 450.0).to_bits(), 0);
    }
    let at = |t| fuel.vapour_cross_section_m2_mol(3.4, t);
    assert_eq!(at(200.0).to_bits(), at(300.0).to_bits());
    assert_eq!(at(900.0).to_bits(), at(650.0).to_bits());
    assert!((at(325.0) - 0.5 * (at(300.0) + at(350.0))).abs() < 1e-12);
}

#[test]
fn the_index_stays_finite_and_falls_with_density_up_to_any_temperature() {
    for name in NAMES {
        let fuel = Fuel::named(name).unwrap();
        let [_, to] = fuel.density_range_k();
        for um in [2.0, 2.5, 3.38, 3.42, 6.0, 9.0] {
            let mut before = f64::INFINITY;
            for t in [0.0, 100.0, 239.0, 280.0, 400.0, to, to + 1.0, 2000.0] {
                let (n, k) = fuel.liquid_index(um, t);
                assert!(n.is_finite() && n > 1.0 && (0.0..1.0).contains(&k), "{name} {um} um {t} K: {n} {k}");
                // |m² - 1| follows the density.
                let m = Complex::new(n, k);
                let strength = (m * m - Complex::new(1.0, 0.0)).abs();
                assert!(strength <= before * (1.0 + 1e-12), "{name} {um} um {t} K");
                before = strength;
            }
            // A mixture's range ends with that of its first part; the others go on a little.
            let (end, beyond) = (fuel.liquid_index(um, to + 300.0), fuel.liquid_index(um, to + 500.0));
            assert_eq!(end.0.to_bits(), beyond.0.to_bits(), "{name}");
        }
    }
}

#[test]
fn vapour_between_two_temperatures_of_the_table_is_within_a_thousandth() {
    // Every inner column from its neighbours 50 K away on either side: the error of a straight line is a quarter
    // of that between columns. 1e-3 of the band's largest value, then, is far below the model's 15 %.
    for name in NAMES {
        let fuel = Fuel::named(name).unwrap();
        for own in 1..fuel.vapour_k.len() - 1 {
            let column = |at: usize| &fuel.vapour_m2_mol[at];
            let largest = column(own).iter().copied().fold(0.0, f64::max);
            for index in 0..fuel.vapour_um.len() {
                let mean = 0.5 * (column(own - 1)[index] + column(own + 1)[index]);
                let error = 0.25 * (mean - column(own)[index]).abs() / largest;
                assert!(
                    error < 1e-3,
                    "{name} {} um {} K: {error}",
                    fuel.vapour_um[index],
                    fuel.vapour_k[own]
                );
            }
        }
    }
}

#[test]
fn impossible_tables_are_refused() {
    let density = || Density::Rackett {
        reference_kg_m3: 700.0,
        reference_k: 298.0,
        critical_k: 560.0,
        compressibility: 0.26,
        range_k: [280.0, 500.0],
    };
    let liquid = "wavelength_um,n,k\n3,1.4,0.1\n4,1.4,0.1\n";
    let vapour = "wavelength_um,sigma_m2_mol_300K\n3,1\n4,1\n";
    let make =
        |liquid: &str, vapour: &str, mass| Fuel::from_csv("own", "test", liquid, vapour, mass, density());
    assert!(make(liquid, vapour, 0.1).is_ok());
    assert!(matches!(make(liquid, vapour, -0.1), Err(FuelError::Value { .. })));
    assert!(matches!(make("wavelength_um,n\n3,1\n4,1\n", vapour, 0.1), Err(FuelError::Table { .. })));
    assert!(matches!(make(liquid, "wavelength_um\n3\n4\n", 0.1), Err(FuelError::Table { .. })));
    for bad in ["3,1.4,0.1\n4,1.4,-0.1", "3,1.4,0.1\n4,0,0.1", "3,1.4,0.1\n4,nan,0.1", "3,1.4,0.1\n4,1.4,inf"]
    {
        let error = make(&format!("wavelength_um,n,k\n{bad}\n"), vapour, 0.1).unwrap_err().to_string();
        assert!(error.contains("row 2 (line 3)") && error.contains("table of the liquid"), "{error}");
    }
    // An index whose molar response has a pole when the liquid gets denser.
    assert!(matches!(make("wavelength_um,n,k\n3,6,0\n4,6,0\n", vapour, 0.1), Err(FuelError::Value { .. })));
    let error = Fuel::named("n-heptan").unwrap_err().to_string();
    assert!(error.contains("did you mean `n-heptane`?"), "{error}");
    assert!(!Fuel::named("xyz").unwrap_err().to_string().contains("did you mean"));
}
