//! What the coefficients of a spray must be: sums of single droplets, two temperatures, conservation.

use super::super::compact;
use super::super::deposit;
use super::super::field::{Grid, Parcel};
use super::*;
use crate::light::mie::efficiencies;

const HEPTANE: &str = "n-heptane";

/// Two cells along x; one has parcels, the other vapour.
fn small_field(parcels: Vec<Parcel>, per_m3: f32) -> SprayField {
    let count = u32::try_from(parcels.len()).unwrap();
    SprayField {
        grid: Grid { lower_m: [0.0; 3], upper_m: [2e-3, 1e-3, 1e-3], cells: [2, 1, 1] },
        cells: vec![0, 1],
        gas: vec![
            Gas { temperature_k: 450.0, vapour_mol_m3: 0.0 },
            Gas { temperature_k: 430.0, vapour_mol_m3: 10.0 },
        ],
        deposit_start: vec![0, count, count],
        deposit_parcel: (0..count).collect(),
        deposit_per_m3: vec![per_m3; parcels.len()],
        parcels,
    }
}

fn parcel(diameter_um: f64, temperature_k: f64) -> Parcel {
    Parcel { position_m: [0.0; 3], diameter_m: diameter_um * 1e-6, temperature_k, droplets: 1e4 }
}

fn close(found: f64, wanted: f64, relative: f64, what: &str) {
    assert!((found - wanted).abs() <= relative * wanted.abs(), "{what}: {found:e} against {wanted:e}");
}

#[test]
fn one_size_of_droplets_gives_its_own_cross_section() {
    let fuel = Fuel::named(HEPTANE).unwrap();
    let band = Band::monochromatic(3.42);
    let sources = [Source::UNIT, Source::RADIANCE];
    let found = optics(
        &small_field(vec![parcel(10.0, 360.0)], 1e12),
        &fuel,
        &band,
        &sources,
        &OpticsOptions::default(),
    );
    let (n, k) = fuel.liquid_index(3.42, 360.0);
    let x = std::f64::consts::PI * 10.0 / 3.42;
    let q = efficiencies(x, n, k).unwrap();
    let area = std::f64::consts::FRAC_PI_4 * 1e-10 * f64::from(1e12f32);
    let medium = &found.medium;
    close(medium.k_sca[0], area * q.q_sca, 1e-12, "k_sca");
    close(medium.k_ext[0], area * q.q_ext, 1e-12, "k_ext");
    close(medium.emission[0], area * q.q_abs, 1e-12, "emission of channel 0");
    close(medium.emission[1], area * q.q_abs * photon_radiance(3.42, 360.0), 1e-12, "emission of channel 1");
    close(found.report.asymmetry[0], q.asymmetry, 1e-12, "mean cosine");
    assert!((found.report.asymmetry_tabulated[0] - q.asymmetry).abs() < 1e-6);
    assert!(found.report.phase_error <= 1e-6 && found.report.phase_nodes > 64, "{:?}", found.report);
}

#[test]
fn vapour_emits_at_the_temperature_of_the_gas_and_droplets_at_their_own() {
    let fuel = Fuel::named(HEPTANE).unwrap();
    let band = Band { wavelengths_um: vec![3.38, 3.42], weights: vec![0.5, 0.5], leak_from: None };
    let warmer = Strength::Radiance { offset_k: 7.0 };
    let sources = [
        Source::UNIT,
        Source { species: Species::Droplets, strength: Strength::Unit },
        Source { species: Species::Vapour, strength: warmer },
        Source { species: Species::All, strength: warmer },
    ];
    let found = medium(
        &small_field(vec![parcel(10.0, 360.0)], 1e12),
        &fuel,
        &band,
        &sources,
        &OpticsOptions::default(),
    );
    assert_eq!(found.index, vec![0, 1]);
    for group in 0..2 {
        let um = band.wavelengths_um[group];
        let at = |cell: usize, channel: usize| found.emission[(cell * 4 + channel) * 2 + group];
        let k_abs = |cell: usize| found.k_ext[cell * 2 + group] - found.k_sca[cell * 2 + group];
        // Unit emission is absorption, for each species apart and together.
        close(at(0, 0), k_abs(0), 1e-12, "droplets, unit");
        close(at(0, 1), k_abs(0), 1e-12, "droplets alone");
        close(at(0, 2), 0.0, 0.0, "no vapour in the first cell");
        close(at(0, 3), k_abs(0) * photon_radiance(um, 367.0), 1e-12, "droplets, radiance");
        let vapour = 10.0 * fuel.vapour_cross_section_m2_mol(um, 430.0);
        close(at(1, 0), vapour, 1e-12, "vapour, unit");
        close(at(1, 1), 0.0, 0.0, "no droplets in the second cell");
        close(at(1, 2), vapour * photon_radiance(um, 437.0), 1e-12, "vapour, radiance");
        close(at(1, 3), vapour * photon_radiance(um, 437.0), 1e-12, "vapour of all, radiance");
        close(found.k_sca[2 + group], 0.0, 0.0, "vapour does not scatter");
    }
}

#[test]
fn many_sizes_add_up_to_the_sum_of_single_droplets() {
    // 400 sizes and temperatures between 1 and 60 um: the mean over bins against every droplet by itself. The band
    // absorbs, so ripple is damped; what remains is the width of the bins, (0.0125)²/24 of the second derivative.
    let fuel = Fuel::named(HEPTANE).unwrap();
    let band = Band::monochromatic(3.42);
    let parcels: Vec<Parcel> = (0..400)
        .map(|i| parcel((f64::from(i) / 399.0 * 60f64.ln()).exp(), 340.0 + f64::from(i % 50)))
        .collect();
    let found =
        optics(&small_field(parcels.clone(), 1e10), &fuel, &band, &[Source::UNIT], &OpticsOptions::default());
    let (mut sca, mut abs) = (0.0, 0.0);
    for parcel in &parcels {
        let (n, k) = fuel.liquid_index(3.42, parcel.temperature_k);
        let q = efficiencies(std::f64::consts::PI * parcel.diameter_m / 3.42e-6, n, k).unwrap();
        let area = std::f64::consts::FRAC_PI_4 * parcel.diameter_m.powi(2) * f64::from(1e10f32);
        sca += area * q.q_sca;
        abs += area * q.q_abs;
    }
    println!("{:e} {:e}", found.medium.k_sca[0] / sca - 1.0, found.medium.emission[0] / abs - 1.0);
    println!("{:?}", found.report);
    close(found.medium.k_sca[0], sca, 3e-4, "k_sca");
    close(found.medium.emission[0], abs, 3e-4, "k_abs");
}

#[test]
fn parcels_without_sense_are_left_out_and_counted() {
    let fuel = Fuel::named(HEPTANE).unwrap();
    let mut parcels =
        vec![parcel(10.0, 360.0), parcel(0.0, 360.0), parcel(10.0, f64::NAN), parcel(10.0, 360.0)];
    parcels[3].droplets = 0.0;
    let found = optics(
        &small_field(parcels, 1e10),
        &fuel,
        &Band::monochromatic(3.4),
        &[Source::UNIT],
        &OpticsOptions::default(),
    );
    assert_eq!(found.report.parcels_skipped, 3);
    let alone = optics(
        &small_field(vec![parcel(10.0, 360.0)], 1e10),
        &fuel,
        &Band::monochromatic(3.4),
        &[Source::UNIT],
        &OpticsOptions::default(),
    );
    assert_eq!(found.medium.k_ext[0].to_bits(), alone.medium.k_ext[0].to_bits());
    let none = optics(
        &small_field(Vec::new(), 1e10),
        &fuel,
        &Band::monochromatic(3.4),
        &[Source::UNIT],
        &OpticsOptions::default(),
    );
    assert_eq!(none.medium.k_ext[0].to_bits(), 0);
    assert!(matches!(none.medium.phase[0], PhaseFunction::Isotropic));
}

#[test]
fn the_shipped_spray_is_opaque_in_its_core_and_scatters_forward() {
    let spray = compact::shipped().unwrap();
    let (field, _) = deposit::field(&spray, &deposit::DepositOptions::default()).unwrap();
    let fuel = Fuel::named(HEPTANE).unwrap();
    let response = crate::light::band::Response::filtered_insb().unwrap();
    let band = Band::sample(&response, 16, true).unwrap();
    let found = optics(&field, &fuel, &band, &[Source::UNIT, Source::RADIANCE], &OpticsOptions::default());
    println!("{} parcels, {} cells, {:?}", field.parcels.len(), field.cells.len(), found.report);
    for (&ext, &sca) in found.medium.k_ext.iter().zip(&found.medium.k_sca) {
        assert!(ext.is_finite() && sca >= 0.0 && sca <= ext);
    }
    // optics.md: mean cosine 0.83 to 0.95 for 4 to 30 um in band.
    for (g, table) in found.report.asymmetry.iter().zip(&found.report.asymmetry_tabulated).take(16) {
        assert!((0.7..0.97).contains(g), "{g}");
        assert!((g - table).abs() < 1e-6, "{g} {table}");
    }
    assert!(found.report.phase_error < 1.1e-4, "{}", found.report.phase_error);
    // The phase function that the tracer samples has that mean.
    for (phase, table) in found.medium.phase.iter().zip(&found.report.asymmetry_tabulated) {
        close(phase.mean_cosine(), *table, 1e-10, "mean cosine of the phase function");
    }
    // The total cross-section is the parcels': extensive, whatever the grid.
    let volume = field.grid.cell_volume_m3();
    let cells: f64 = found.medium.k_sca.iter().step_by(band.len()).sum::<f64>() * volume;
    let mut parcels = vec![0.0; field.parcels.len()];
    for (&parcel, &density) in field.deposit_parcel.iter().zip(&field.deposit_per_m3) {
        parcels[parcel as usize] += f64::from(density) * volume;
    }
    let um = band.wavelengths_um[0];
    let mut wanted = 0.0;
    for (parcel, droplets) in field.parcels.iter().zip(parcels) {
        let (n, k) = fuel.liquid_index(um, parcel.temperature_k);
        let q = efficiencies(std::f64::consts::PI * parcel.diameter_m / (um * 1e-6), n, k).unwrap();
        wanted += droplets * std::f64::consts::FRAC_PI_4 * parcel.diameter_m.powi(2) * q.q_sca;
    }
    close(cells, wanted, 2e-3, "total scattering cross-section in m2");
}
