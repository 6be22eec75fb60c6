//! Truncated peaks: what is kept exactly, and that the stated error is one.

use super::super::slab::Slab;
use super::*;

fn peaked() -> Vec<(&'static str, PhaseFunction)> {
    let sphere = |size_parameter| crate::light::mie::Sphere { size_parameter, n: 1.38, k: 0.05 };
    let spray =
        super::super::mie::of_spheres(&[sphere(6.0), sphere(13.0), sphere(25.0)], &[9.0, 3.0, 1.0], 1e-6);
    vec![
        ("hg 0.85", PhaseFunction::HenyeyGreenstein { asymmetry: 0.85 }),
        ("hg 0.95", PhaseFunction::HenyeyGreenstein { asymmetry: 0.95 }),
        ("spray", spray.unwrap().phase),
    ]
}

#[test]
fn moments_are_those_of_closed_forms() {
    let chi = moments(&PhaseFunction::Rayleigh, 5);
    // ¾ (1 + μ²) = 1 + ½ P₂, and χ₂ = ½ / 5.
    for (found, wanted) in chi.iter().zip([1.0, 0.0, 0.1, 0.0, 0.0]) {
        assert!((found - wanted).abs() < 1e-13);
    }
    // A table of Henyey and Greenstein's function at 8000 angles: curvature of p over steps of 4e-4 rad.
    let theta: Vec<f64> = (0..=8000).map(|i| PI * f64::from(i) / 8000.0).collect();
    let hg = PhaseFunction::HenyeyGreenstein { asymmetry: 0.7 };
    let p: Vec<f64> = theta.iter().map(|t| hg.value(t.cos())).collect();
    let (table, _) = super::super::PhaseTable::new(&theta, &p).unwrap();
    for (l, chi) in moments(&PhaseFunction::Table(Arc::new(table)), 40).iter().enumerate() {
        assert!((chi - 0.7f64.powf(l as f64)).abs() < 1e-6, "{l}: {chi}");
    }
}

#[test]
fn mean_cosine_and_absorption_are_kept_and_nothing_is_negative() {
    for (name, phase) in peaked() {
        let cones = [0.3, 2.0, 10.0, 90.0].map(|degrees: f64| cone(&phase, degrees.to_radians()).unwrap());
        let series = [1, 3, 8, 30, 150].map(|order| delta_m(&phase, order).unwrap());
        for cut in cones.iter().chain(&series) {
            let f = cut.fraction;
            assert!((0.0..1.0).contains(&f), "{name} {:?}: {f}", cut.form);
            let mean = f + (1.0 - f) * cut.phase.mean_cosine();
            assert!((mean - phase.mean_cosine()).abs() < 1e-8, "{name} {:?}: {mean}", cut.form);
            let (k, albedo) = (3.0, 0.7);
            let absorbed = cut.extinction(k, albedo) * (1.0 - cut.albedo(albedo));
            assert!((absorbed - k * (1.0 - albedo)).abs() < 1e-14);
            let left = cut.extinction(k, albedo) * cut.albedo(albedo);
            assert!((left - cut.scattering(k * albedo)).abs() < 1e-14);
            for i in -50..=50 {
                assert!(cut.phase.value(f64::from(i) / 50.0) >= 0.0, "{name} {:?} {i}", cut.form);
            }
            let errors = cut.eigenvalue_errors(3);
            assert!(errors[0].abs() < 1e-12 && errors[1].abs() < 1e-8, "{name}: {errors:?}");
        }
        // Moments below the order are kept by the series, where it is no cone.
        for cut in series.iter().filter(|cut| matches!(cut.form, Form::DeltaM { .. })) {
            let Form::DeltaM { order } = cut.form else { continue };
            for (l, error) in cut.eigenvalue_errors(order).iter().enumerate() {
                assert!(error.abs() < 1e-5, "{name} order {order}: {l} {error:e}");
            }
        }
    }
}

#[test]
fn functions_without_a_peak_stay_whole_and_bad_cones_are_refused() {
    let backward = PhaseFunction::HenyeyGreenstein { asymmetry: -0.6 };
    let cut = delta_m(&backward, 3).unwrap();
    assert_eq!((cut.form, cut.fraction.to_bits()), (Form::Whole, 0));
    for asymmetry in [-1.0, 1.0] {
        let cut = cone(&PhaseFunction::HenyeyGreenstein { asymmetry }, 0.1).unwrap();
        assert!((cut.fraction - asymmetry.max(0.0)).abs() < f64::EPSILON);
        assert!(cut.albedo(1.0).is_finite() && cut.error(2.0, 1.0).is_finite());
    }
    for bad in [0.0, -0.1, 1.6, f64::NAN] {
        assert!(matches!(cone(&PhaseFunction::Isotropic, bad), Err(PhaseError::Cone { .. })));
    }
    assert!(delta_m(&PhaseFunction::Isotropic, 0).is_err());
    // No peak to speak of: a cone takes its own share away and is compensated.
    let cut = cone(&PhaseFunction::Isotropic, 0.2).unwrap();
    assert!(cut.fraction < 0.5 * versine(0.2) && cut.phase.mean_cosine() < 0.0);
}

#[test]
fn single_scattering_of_a_cone_is_that_of_the_whole_outside_of_it() {
    let phase = PhaseFunction::HenyeyGreenstein { asymmetry: 0.9 };
    let cut = cone(&phase, 0.1).unwrap();
    let albedo = 0.6;
    // ω′ p′ / ω and p / (1 − ω f) differ by the isotropic part, ½∫p (1 − μ) dμ over the cone.
    let isotropic = (phase.within(0.1f64.cos()) - cut.fraction) / (1.0 - albedo * cut.fraction);
    for cosine in [0.9, 0.5, 0.0, -0.8] {
        let ours = cut.albedo(albedo) / albedo * cut.phase.value(cosine) - isotropic;
        let exact = cut.single_scattering(albedo, cosine);
        // The density inside a cell of the cut function is a straight line.
        assert!((ours - exact).abs() < 1e-2 * exact, "{cosine}: {ours} {exact}");
    }
}

/// Slabs by adding and doubling with 24 streams a side, with and without the peak: the rms change of the plate's
/// share over all directions is below the stated error, and not by orders.
#[test]
fn coefficients_of_slabs_change_by_less_than_stated() {
    for (name, phase) in peaked() {
        for degrees in [3.0f64, 8.0] {
            let cut = cone(&phase, degrees.to_radians()).unwrap();
            for (depth, albedo) in [(0.3, 0.6), (1.0, 0.6), (1.0, 1.0), (3.0, 0.95)] {
                let full = Slab::new(&phase, depth, albedo);
                let less = Slab::new(&cut.phase, cut.extinction(depth, albedo), cut.albedo(albedo));
                for lowest_cosine in [0.0, 0.5] {
                    let (mut square, mut weight) = (0.0, 0.0);
                    for (before, after) in full.plate(lowest_cosine).iter().zip(less.plate(lowest_cosine)) {
                        square += before.1 * (before.0 - after.0) * (before.0 - after.0);
                        weight += before.1;
                    }
                    let change = (square / weight).sqrt();
                    // Through an oblique slab of a mean secant of 2.
                    let size = if lowest_cosine > 0.0 { 2.0 * PI / 3.0 } else { PI };
                    let stated = cut.error(2.0 * albedo * depth, size);
                    println!(
                        "{name} {degrees} deg, {depth} {albedo} {lowest_cosine}: {change:.2e} of {stated:.2e}"
                    );
                    assert!(change <= stated, "{name} {degrees} {depth} {albedo}: {change:e} {stated:e}");
                    assert!(change >= 1e-3 * stated, "{name} {degrees}: {change:e} is far below {stated:e}");
                }
            }
        }
    }
}

/// Light that falls in along one direction: delta-M alone is wrong by its negative or smeared peak, with the single
/// scattering of the whole function it is right to a few percent of that.
#[test]
fn single_scattering_correction_mends_delta_m() {
    let phase = PhaseFunction::HenyeyGreenstein { asymmetry: 0.85 };
    let (depth, albedo) = (0.3, 0.9);
    let exact = Slab::new(&phase, depth, albedo);
    // The fraction of order 8, the moments scaled: as a series, since nothing is sampled here.
    let order = 8;
    let chi = moments(&phase, 48);
    let f = chi[order];
    let scaled: Vec<f64> = (0..48).map(|l| if l < order { (chi[l] - f) / (1.0 - f) } else { 0.0 }).collect();
    let (depth_left, albedo_left) = ((1.0 - albedo * f) * depth, albedo * (1.0 - f) / (1.0 - albedo * f));
    let truncated = Slab::from_moments(&scaled, depth_left, albedo_left);
    let source = exact.streams() - 1;
    let (mut plain, mut mended) = (0.0, 0.0);
    for stream in 0..source - 6 {
        let wanted = exact.scattered_through(source, stream);
        let found = truncated.scattered_through(source, stream);
        let own = truncated.once_through(&scaled, albedo_left, depth_left, source, stream);
        let tms = truncated.once_through(&chi, albedo / (1.0 - albedo * f), depth_left, source, stream);
        plain += (found - wanted) * (found - wanted);
        mended += (found - own + tms - wanted) * (found - own + tms - wanted);
    }
    println!("squares {plain:e} {mended:e}");
    assert!(mended < 0.02 * plain, "{mended:e} {plain:e}");
}
