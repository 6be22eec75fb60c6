//! Skips: the work is not done, and the answer moves by less than stated.

use super::super::field::Grid;
use super::*;
use crate::tracer::plate::{Plate, PlateShape};
use crate::tracer::rays::{RayAnswer, RayOptions, render_rays};
use crate::tracer::shape::Body;

const FINE: OpticsOptions = OpticsOptions { target_error: 1e-9 };

fn fuel() -> Fuel {
    Fuel::named("n-heptane").unwrap()
}

/// One cell of a decimetre with droplets of one size, one with vapour.
fn field(diameter_um: f64, per_m3: f32, vapour_mol_m3: f64) -> SprayField {
    let droplets =
        Parcel { position_m: [0.0; 3], diameter_m: diameter_um * 1e-6, temperature_k: 360.0, droplets: 1e4 };
    let gas = |vapour_mol_m3| Gas { temperature_k: 430.0, vapour_mol_m3 };
    SprayField {
        grid: Grid { lower_m: [0.0; 3], upper_m: [0.2, 0.1, 0.1], cells: [2, 1, 1] },
        cells: vec![0, 1],
        gas: vec![gas(0.0), gas(vapour_mol_m3)],
        deposit_start: vec![0, 1, 1],
        deposit_parcel: vec![0],
        deposit_per_m3: vec![per_m3],
        parcels: vec![droplets],
    }
}

fn reasons(report: &OpticsReport) -> Vec<Work> {
    report.skipped.iter().map(|skip| skip.work).collect()
}

#[test]
fn without_droplets_nothing_is_asked_of_mie() {
    let band = Band::monochromatic(3.42);
    let with = field(10.0, 1e9, 5.0);
    let mut without = field(10.0, 1e9, 5.0);
    // The parcel is still listed, but no cell holds any of it.
    (without.deposit_start, without.deposit_parcel, without.deposit_per_m3) = (vec![0; 3], vec![], vec![]);
    let none = optics(&without, &fuel(), &band, &[Source::UNIT], &OpticsOptions::default());
    assert_eq!((none.report.mie_spheres, none.report.phase_tables), (0, 0));
    assert_eq!(reasons(&none.report), [Work::Mie, Work::Phase]);
    assert!(none.report.skipped.iter().all(|skip| skip.admitted_error == 0.0 && skip.groups == 1));
    let some = optics(&with, &fuel(), &band, &[Source::UNIT], &OpticsOptions::default());
    assert!(some.report.mie_spheres > 0 && some.report.skipped.is_empty());
    // What has no droplets is what it was.
    assert_eq!(none.medium.k_ext[1].to_bits(), some.medium.k_ext[1].to_bits());
    assert!(none.medium.k_ext[1] > 0.0);
    without.parcels.clear();
    let empty = optics(&without, &fuel(), &band, &[Source::UNIT], &OpticsOptions::default());
    assert_eq!(empty.medium.k_ext, none.medium.k_ext);
}

#[test]
fn without_vapour_there_is_no_table_of_it() {
    let band = Band::monochromatic(3.42);
    let dry = optics(&field(10.0, 1e9, 0.0), &fuel(), &band, &[Source::UNIT], &OpticsOptions::default());
    assert_eq!((dry.report.vapour_nodes, reasons(&dry.report)), (0, vec![Work::Vapour]));
    let wet = optics(&field(10.0, 1e9, 5.0), &fuel(), &band, &[Source::UNIT], &OpticsOptions::default());
    assert!(wet.report.vapour_nodes > 100);
    assert_eq!(dry.medium.k_ext[0].to_bits(), wet.medium.k_ext[0].to_bits());
    assert_eq!(dry.medium.k_ext[1].to_bits(), 0);
}

/// Rays along x and askew through the droplets, with a black body at infinity behind.
fn trace(medium: &GridMedium, group: usize) -> Vec<RayAnswer> {
    let body = Body::grid(medium, group).unwrap();
    let plate = PlateShape::Cone { facing: [-1.0, 0.0, 0.0], half_angle_deg: 20.0 };
    let rays = [([-1.0, 0.05, 0.05], [1.0, 0.0, 0.0]), ([-0.2, 0.03, 0.06], [1.0, 0.1, -0.05])];
    let options = RayOptions { target_error: 1e-7, paths_max: 1 << 15, ..RayOptions::default() };
    render_rays(&body, &rays, Some(&Plate::new(&plate).unwrap()), &options).unwrap()
}

/// Both media differ in the phase function only, and no coefficient by more than was admitted.
fn within_what_is_admitted(skipped: &Optics, full: &Optics, group: usize) {
    assert_eq!((skipped.report.phase_tables, full.report.phase_tables), (0, 1));
    assert!(skipped.report.mie_spheres < full.report.mie_spheres);
    assert!(reasons(&full.report).is_empty());
    assert_eq!(skipped.medium.k_ext, full.medium.k_ext);
    let [skip] = skipped.report.skipped[..] else { panic!("{:?}", skipped.report.skipped) };
    assert_eq!((skip.work, skip.groups), (Work::Phase, 1));
    assert!(skip.admitted_error > 0.0 && skip.admitted_error <= 5e-4, "{skip:?}");
    for (a, b) in trace(&skipped.medium, group).iter().zip(trace(&full.medium, group)) {
        assert!(a.optical_depth > 0.3, "{}", a.optical_depth);
        for (a, b, se) in [
            (a.plate, b.plate, a.se_plate.hypot(b.se_plate)),
            (a.walls, b.walls, a.se_walls.hypot(b.se_walls)),
            (a.medium[0], b.medium[0], a.se_medium[0].hypot(b.se_medium[0])),
        ] {
            // 4.5 standard errors with 31 degrees of freedom: 1e-4 in all.
            assert!((a - b).abs() <= skip.admitted_error + 4.5 * se, "{a} {b} {se:e} {skip:?}");
            // The noise must not hide what is asked.
            assert!(se < 0.1 * 5e-4, "{se:e}");
        }
    }
}

#[test]
fn an_albedo_below_the_target_needs_no_phase_function() {
    // Droplets of 80 nm absorb two thousand times what they scatter.
    let (field, band) = (field(0.08, 1e17, 5.0), Band::monochromatic(3.42));
    let quick = optics(&field, &fuel(), &band, &[Source::UNIT], &OpticsOptions::default());
    let full = optics(&field, &fuel(), &band, &[Source::UNIT], &FINE);
    let albedo = quick.medium.k_sca[0] / quick.medium.k_ext[0];
    assert_eq!(quick.report.skipped[0].admitted_error.to_bits(), albedo.to_bits());
    assert!(matches!(quick.medium.phase[0], PhaseFunction::Isotropic));
    within_what_is_admitted(&quick, &full, 0);
}

#[test]
fn small_droplets_scatter_as_rayleigh_says() {
    // Between the bands the liquid hardly absorbs: small droplets scatter a share worth knowing.
    let (field, band) = (field(0.1, 1e19, 5.0), Band::monochromatic(3.9));
    let quick = optics(&field, &fuel(), &band, &[Source::UNIT], &OpticsOptions::default());
    let full = optics(&field, &fuel(), &band, &[Source::UNIT], &FINE);
    assert!(matches!(quick.medium.phase[0], PhaseFunction::Rayleigh), "{:?}", quick.report);
    assert!(quick.medium.k_sca[0] > 5e-4 * quick.medium.k_ext[0]);
    within_what_is_admitted(&quick, &full, 0);
}
