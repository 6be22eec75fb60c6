//! Sprays as wholes: mass and energy are conserved, tips are as published, bad values are named, bits repeat.

use super::description::{HollowCone, MultiHole};
use super::*;

fn multi_hole(text: &str) -> SpraySource<Injector> {
    let source: SpraySource<MultiHole> = toml::from_str(&format!("fuel = \"isooctane\"\n{text}")).unwrap();
    source.with_injector(Injector::MultiHole)
}

fn hollow_cone(text: &str) -> SpraySource<Injector> {
    let source: SpraySource<HollowCone> = toml::from_str(&format!("fuel = \"isooctane\"\n{text}")).unwrap();
    source.with_injector(Injector::HollowCone)
}

fn made(source: &SpraySource<Injector>) -> ParametricSpray {
    spray(source, &Fuel::named(&source.fuel).unwrap()).unwrap()
}

/// The jet alone, without a grid.
fn jet(source: &SpraySource<Injector>) -> (Jet, Properties) {
    jet_of(source, |start| start)
}

fn jet_of(source: &SpraySource<Injector>, change: impl Fn(Start) -> Start) -> (Jet, Properties) {
    let thermal = FuelProperties::named(&source.fuel).unwrap();
    let feed = source.injector.feed();
    let properties = Properties::new(thermal, source.gas.pressure_pa, feed.fuel_temperature_k);
    let start = change(start(source, thermal, &properties));
    (Jet::at(start, &properties, source.time_s).unwrap(), properties)
}

/// The jet's fuel and gas alone: droplets in it move with it and change neither.
fn flow(source: &SpraySource<Injector>) -> (Jet, Properties) {
    jet_of(source, |start| Start { classes: Vec::new(), ..start })
}

/// Liquid and vapour on the grid are what was injected: 1e-6, of which 2e-7 are the tail that is cut off and the rest
/// the rounding of the densities to single precision.
#[test]
fn mass_on_the_grid_is_the_mass_injected() {
    for source in [
        multi_hole("cell_m = 0.001"),
        multi_hole(
            "time_s = 2e-4\ncell_m = 0.001\ninjector = { holes = 1, angle_deg = 0, pitch_circle_m = 0 }",
        ),
        multi_hole(
            "time_s = 5e-4\ncell_m = 0.002\ninjector = { duration_s = 3e-4 }\ntip_m = [1, -2, 3]\naxis = [3, 0, 0]",
        ),
        hollow_cone("time_s = 3e-4\ncell_m = 0.001"),
    ] {
        let injected = source.time_s.min(source.injector.feed().duration_s);
        let summary = made(&source).summary;
        let on_grid = summary.liquid_kg + summary.vapour_kg;
        assert!((summary.injected_kg - summary.flow_kg_s * injected).abs() < 1e-12 * summary.injected_kg);
        assert!((on_grid / summary.injected_kg - 1.0).abs() < 1e-6, "{on_grid} {summary:?}");
        assert!(summary.vapour_kg > 0.0 && summary.liquid_kg > 0.0);
    }
}

/// Flow of Bernoulli's equation, by hand: 8 · 0.5 · π/4 d² √(2 ρ Δp), 0.8 % of it for ρ(363 K) by another route.
#[test]
fn the_flow_is_that_of_spray_g() {
    let summary = made(&multi_hole("time_s = 1e-4\ncell_m = 0.002")).summary;
    let by_hand = 8.0 * 0.5 * PI / 4.0 * 165e-6_f64.powi(2) * (2.0 * 630.0 * 194e5_f64).sqrt();
    assert!((summary.flow_kg_s / by_hand - 1.0).abs() < 0.01, "{}", summary.flow_kg_s);
    // 10 mg in 0.78 ms.
    assert!((summary.flow_kg_s * 0.78e-3 / 10e-6 - 1.0).abs() < 0.06);
}

/// The enthalpy of fuel and gas in every tube is the one they came with. Newton's four steps and the mixing of liquid
/// by temperature instead of enthalpy leave a thousandth of the heat that was exchanged.
#[test]
fn energy_is_conserved_in_every_tube() {
    let source = multi_hole("");
    let (jet, properties) = jet(&source);
    let classes = &jet.start.classes;
    let hot = properties.at(jet.start.gas_k).gas_j_kg;
    for tube in jet.sections.iter().filter(|s| s.fuel_kg > 1e-15).flat_map(|s| &s.tubes) {
        let liquid: f64 = tube
            .drops
            .iter()
            .zip(classes)
            .map(|(d, c)| c.share * d.left * properties.at(d.temperature_k).liquid_j_kg)
            .sum();
        let vapour = tube.vapour(classes);
        let now = properties.at(tube.gas_k);
        let fuel = liquid + vapour * now.vapour_j_kg;
        let gas = tube.gas_ratio * (hot - now.gas_j_kg);
        assert!((fuel - gas).abs() <= 1e-3 * fuel.abs().max(1e3), "{fuel} {gas}");
        assert!((200.0..=573.0 + 1e-9).contains(&tube.gas_k));
        let moist = vapour / (vapour + tube.gas_ratio);
        // Vapour never exceeds what saturates the gas at the warmest droplets.
        let warmest = tube.drops.iter().filter(|d| d.left > 0.0).map(|d| d.temperature_k).fold(0.0, f64::max);
        if warmest > 0.0 && tube.gas_ratio > 0.1 {
            assert!(moist < 1.02 * droplet::surface(&properties, warmest) + 1e-3, "{moist} {warmest}");
        }
    }
}

/// Until the end of injection the tip is Naber and Siebers' with the same angle: within a tenth from 0.1 ms on. (Their
/// control volume has a flat profile in 0.66 of the width; β = 2.02 in all of it moves √(2.02)·0.66 = 0.94 as fast.)
#[test]
fn the_tip_is_as_published() {
    for (time_s, gas_pa, angle) in
        [(1e-4, 6e5, 20.0), (3e-4, 6e5, 20.0), (7e-4, 6e5, 20.0), (5e-4, 2e6, 15.0), (5e-4, 1e5, 25.0)]
    {
        let source = multi_hole(&format!(
            "time_s = {time_s}\ngas = {{ pressure_pa = {gas_pa} }}\nplume = {{ angle_deg = {angle} }}"
        ));
        let (jet, properties) = flow(&source);
        let [naber_siebers, _] = published_tips_m(&source, &properties, angle).unwrap();
        let ratio = jet.within_m(0.99) / naber_siebers;
        assert!((0.88..1.04).contains(&ratio), "{time_s} {gas_pa}: {ratio}");
    }
}

#[test]
fn droplets_do_not_move_the_jet() {
    let source = multi_hole("time_s = 1.5e-4\ninjector = { duration_s = 1e-4 }");
    let [(with, _), (without, _)] = [jet(&source), flow(&source)];
    assert!((with.step_m / without.step_m - 1.0).abs() < 1e-15);
    let fuel = |jet: &Jet| -> Vec<f64> { jet.sections.iter().map(|s| s.fuel_kg).collect() };
    assert_eq!(fuel(&with), fuel(&without));
}

/// Musculus and Kattke's entrainment wave: near the nozzle the jet leans out once the injection has ended.
#[test]
fn after_the_injection_the_spray_leaves_the_nozzle() {
    let near = |time_s: f64| {
        let (jet, _) = flow(&multi_hole(&format!("time_s = {time_s}\ninjector = {{ duration_s = 3e-4 }}")));
        let first: f64 = jet
            .sections
            .iter()
            .enumerate()
            .filter(|(i, _)| (*i as f64) * jet.step_m < 3e-3)
            .map(|(_, s)| s.fuel_kg)
            .sum();
        first / jet.fuel_kg()
    };
    let [during, just_after, later] = [2.9e-4, 4e-4, 8e-4].map(near);
    assert!(just_after < 0.3 * during && later < 0.5 * just_after, "{during} {just_after} {later}");
}

#[test]
fn evaporation_goes_the_right_way() {
    let share = |text: &str| {
        let (jet, _) = jet(&multi_hole(text));
        let classes = &jet.start.classes;
        let part = |section: &jet::Section| -> f64 {
            (0..section.tubes.len())
                .map(|tube| {
                    let [from, to] = Jet::tube_shares(tube);
                    (to - from) * section.tubes[tube].vapour(classes)
                })
                .sum::<f64>()
                * section.fuel_kg
        };
        jet.sections.iter().map(part).sum::<f64>() / jet.fuel_kg()
    };
    let usual = share("time_s = 2e-4");
    assert!(share("time_s = 1e-4") < usual);
    assert!(share("time_s = 2e-4\ngas = { temperature_k = 400 }") < usual);
    assert!(share("time_s = 2e-4\ndroplets = { sauter_mean_m = 20e-6 }") < usual);
    assert!(share("time_s = 2e-4\ninjector = { fuel_temperature_k = 300 }") < usual);
    // Superheated fuel flashes, cold gas hardly evaporates, and nothing leaves 0 … 1.
    for (text, range) in [
        ("gas = { pressure_pa = 5e4 }\ninjector = { fuel_temperature_k = 363 }", 0.3..1.0),
        ("gas = { temperature_k = 280 }\ninjector = { fuel_temperature_k = 300 }", 0.0..0.2),
        ("gas = { pressure_pa = 2e6, temperature_k = 700 }", 0.5..1.0 + 1e-12),
    ] {
        let got = share(text);
        assert!(range.contains(&got), "{text}: {got}");
    }
}

/// Mean and rms over shots of single cells, correlation of neighbours along a ray from the tip.
#[test]
fn shots_have_the_stated_statistics() {
    let law = "shots = { turbulence = 0.25, integral_scale = 0.06, mass = 0.05, angle_deg = 0.5 }";
    let made = made(&multi_hole(&format!("time_s = 4e-4\ncell_m = 0.002\n{law}")));
    let shots = 400_u64;
    let cells = made.field.cells.len();
    let (mut sum, mut square) = (vec![0.0_f64; cells], vec![0.0_f64; cells]);
    let mut masses = Vec::new();
    let fuel: Vec<f64> = (0..cells).map(|c| made.shots.fuel_kg(c)).collect();
    let total: f64 = fuel.iter().sum();
    for shot in 0..shots {
        let factors = made.shots.factors(shot);
        masses.push(factors.iter().zip(&fuel).map(|(f, kg)| f64::from(*f) * kg).sum::<f64>() / total);
        for (i, factor) in factors.iter().enumerate() {
            sum[i] += f64::from(*factor);
            square[i] += f64::from(factor * factor);
        }
    }
    let n = shots as f64;
    // Cells in the middle of one plume: the stated turbulence and mass alone.
    let inside = made.shots.middle(0.15);
    assert!(inside.len() >= 10, "{}", inside.len());
    let expected = ((1.0 + 0.25_f64.powi(2)) * (1.0 + 0.05_f64.powi(2)) - 1.0).sqrt();
    for &cell in &inside {
        let mean = sum[cell] / n;
        let rms = (square[cell] / n - mean * mean).sqrt() / mean;
        // Five standard errors of a mean, and one hundredth for the masses that are put right.
        assert!((mean - 1.0).abs() < 5.0 * expected / n.sqrt() + 0.01, "{mean}");
        // The tilt adds to it away from the axis, putting the masses right takes from it.
        assert!((0.8..1.3).contains(&(rms / expected)), "{rms} {expected}");
    }
    // All cells keep their mean; at the edge fluctuations are a few times the mean.
    for (i, s) in sum.iter().enumerate() {
        let rms = (square[i] / n - (s / n).powi(2)).max(0.0).sqrt();
        assert!((s / n - 1.0).abs() < 6.0 * rms.max(0.3) / n.sqrt() + 0.03, "{i}: {} {rms}", s / n);
    }
    // Eight plumes of 5 %: 1.8 % of the total.
    let mean = masses.iter().sum::<f64>() / n;
    let rms = (masses.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / n).sqrt();
    assert!((mean - 1.0).abs() < 5.0 * 0.018 / n.sqrt(), "{mean}");
    assert!((rms / (0.05 / 8.0_f64.sqrt()) - 1.0).abs() < 5.0 / (2.0 * n).sqrt() + 0.02, "{rms}");
}

/// Without tilt and mass the logarithm of two factors on one ray is correlated by exp(−(Δ ln r)²/2λ²).
#[test]
fn eddies_have_the_stated_size() {
    let law = "shots = { turbulence = 0.25, integral_scale = 0.3, mass = 0.0, angle_deg = 0.0 }";
    let made = made(&multi_hole(&format!(
        "time_s = 4e-4\ncell_m = 0.001\n{law}\ninjector = {{ holes = 1, angle_deg = 0, pitch_circle_m = 0 }}"
    )));
    let lambda = 0.3 / std::f64::consts::FRAC_PI_2.sqrt();
    let near_axis = made.shots.middle(0.2);
    let place = |cell: usize| made.shots.place(cell).map(|y| y * lambda);
    let (first, mut pairs) = (near_axis[near_axis.len() / 2], Vec::new());
    for &cell in &near_axis {
        let distance: f64 = place(first).iter().zip(place(cell)).map(|(a, b)| (a - b).powi(2)).sum();
        pairs.push((cell, (-0.5 * distance / (lambda * lambda)).exp()));
    }
    let shots = 1000_u64;
    let eddies: Vec<_> = (0..shots).map(|shot| made.shots.eddies(shot)).collect();
    let values =
        |cell: usize| -> Vec<f64> { eddies.iter().map(|eddies| eddies.at(made.shots.place(cell))).collect() };
    let at_first = values(first);
    let mut seen = [false; 2];
    for (cell, expected) in pairs {
        let got = at_first.iter().zip(values(cell)).map(|(a, b)| a * b).sum::<f64>() / shots as f64;
        // Five standard errors of a product of two normal numbers.
        assert!((got - expected).abs() < 5.0 * (2.0 / shots as f64).sqrt(), "{got} {expected}");
        seen[0] |= expected < 0.3;
        seen[1] |= (0.4..0.9).contains(&expected);
    }
    assert_eq!(seen, [true; 2], "near and far cells were compared");
}

#[test]
fn a_seed_names_the_shots_and_a_law_of_zeros_has_none() {
    let text = "time_s = 1e-4\ncell_m = 0.002";
    let [one, two] = [1, 2].map(|seed| made(&multi_hole(&format!("{text}\nseed = {seed}"))).shots);
    let third = two.factors(3);
    assert_ne!(one.factors(3), third);
    assert!(one.fluctuates());
    assert_eq!(one.with_seed(2).factors(3), third);
    let still =
        made(&multi_hole(&format!("{text}\nshots = {{ turbulence = 0, mass = 0, angle_deg = 0 }}"))).shots;
    assert!(!still.fluctuates() && still.factors(3).iter().all(|f| (f - 1.0).abs() < 1e-6));
}

#[test]
fn a_shot_has_the_same_bits_on_any_number_of_threads() {
    let source = multi_hole("time_s = 2e-4\ncell_m = 0.002\nshot = 7");
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| made(&source).field)
    };
    let one = on(1);
    assert_eq!(one, on(3));
    let mut other = source.clone();
    other.shot = Some(8);
    let other = made(&other).field;
    assert_ne!(one, other);
    assert_eq!(one.cells, other.cells);
}

#[test]
fn impossible_values_are_refused_with_table_key_and_range() {
    for (text, words) in [
        ("injector = { holes = 0 }", vec!["[medium.injector] holes is 0", "1 to 64"]),
        ("time_s = -1", vec!["[medium] time_s is -1"]),
        ("time_s = nan", vec!["[medium] time_s is NaN"]),
        ("axis = [0, 0, 0]", vec!["[medium] axis", "direction"]),
        ("tip_m = [0, inf, 0]", vec!["[medium] tip_m"]),
        ("gas = { species = \"CO2\" }", vec!["[medium.gas] species \"CO2\"", "N2"]),
        ("gas = { temperature_k = 2000 }", vec!["[medium.gas] temperature_k is 2000", "280 to 700 K"]),
        (
            "gas = { pressure_pa = 1.5e6 }\ninjector = { rail_pressure_pa = 2e6 }",
            vec!["rail_pressure_pa", "twice"],
        ),
        (
            "injector = { discharge_coefficient = 0.95 }",
            vec!["discharge_coefficient", "velocity_coefficient"],
        ),
        ("injector = { fuel_temperature_k = 700 }", vec!["[medium.injector] fuel_temperature_k", "700 K"]),
        ("droplets = { spread = 1.0 }", vec!["[medium.droplets] spread is 1", "1.3 to 20"]),
        ("evaporates_as = \"water\"", vec!["[medium] evaporates_as", "water", "isooctane"]),
        ("time_s = 2e-4\ncell_m = 2e-5", vec!["[medium] cell_m", "cells"]),
        ("shots = { turbulence = -0.1 }", vec!["[medium.shots] turbulence is -0.1"]),
    ] {
        let source = multi_hole(text);
        let error = spray(&source, &Fuel::named("isooctane").unwrap()).unwrap_err();
        for word in words {
            assert!(error.contains(word), "{text}: {error}");
        }
    }
    // A mixture evaporates as somebody says.
    let mut mixture = multi_hole("time_s = 1e-4\ncell_m = 0.002");
    mixture.fuel = "E10-surrogate".to_owned();
    let fuel = Fuel::named("E10-surrogate").unwrap();
    let error = spray(&mixture, &fuel).unwrap_err();
    assert!(error.contains("[medium] fuel") && error.contains("evaporates_as"), "{error}");
    mixture.evaporates_as = Some("isooctane".to_owned());
    assert!(spray(&mixture, &fuel).is_ok());
}

/// Fuel over the azimuth, 10 to 15 mm below the tip: as many plumes as holes, where they were put; a cone has none.
#[test]
fn plumes_are_where_the_holes_point() {
    let bins = 72;
    let around = |source: &SpraySource<Injector>| {
        let made = made(source);
        let (grid, size) = (made.field.grid, made.field.grid.cell_m());
        let mut sums = vec![0.0; bins];
        for (ordinal, &cell) in made.field.cells.iter().enumerate() {
            let index = grid.cell(cell as usize);
            let at: [f64; 3] = std::array::from_fn(|a| grid.lower_m[a] + (index[a] as f64 + 0.5) * size[a]);
            if (-0.015..-0.010).contains(&at[2]) {
                // About −z right-handed: from +x towards −y.
                let turn = (-at[1]).atan2(at[0]).rem_euclid(2.0 * PI) / (2.0 * PI);
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 ≤ turn < 1")]
                let bin = ((turn * bins as f64) as usize).min(bins - 1);
                sums[bin] += made.shots.fuel_kg(ordinal);
            }
        }
        sums
    };
    let six = around(&multi_hole(
        "time_s = 3e-4\ncell_m = 5e-4\ninjector = { holes = 6, first_azimuth_deg = 32.5 }",
    ));
    let mean = six.iter().sum::<f64>() / bins as f64;
    for (bin, fuel) in six.iter().enumerate() {
        // Bins are 5° wide: 6 is 30° to 35°, the middle of the first plume, every twelfth one of another.
        match bin % 12 {
            6 => assert!(*fuel > 2.0 * mean, "{bin}: {fuel} {mean}"),
            0 => assert!(*fuel < 0.1 * mean, "{bin}: {fuel} {mean}"),
            _ => {}
        }
    }
    let cone = around(&hollow_cone("time_s = 3e-4\ncell_m = 5e-4"));
    let mean = cone.iter().sum::<f64>() / bins as f64;
    // Square cells near the axis give a few per cent.
    assert!(cone.iter().all(|fuel| (fuel / mean - 1.0).abs() < 0.15), "{cone:?}");
}

/// The ends of the allowed ranges: everything is finite, between what can be, and conserved.
#[test]
fn extreme_values_give_finite_fields() {
    let cases = [
        ("n-heptane", "time_s = 1e-6"),
        ("n-heptane", "time_s = 0.02\ncell_m = 0.01\ninjector = { duration_s = 0.1 }"),
        (
            "ethanol",
            "gas = { pressure_pa = 2e4, temperature_k = 700 }\ninjector = { fuel_temperature_k = 450 }\ncell_m = 0.005",
        ),
        (
            "n-hexadecane",
            "gas = { pressure_pa = 2e6, temperature_k = 280 }\ninjector = { fuel_temperature_k = 640 }\ncell_m = 0.003",
        ),
        (
            "n-hexadecane",
            "injector = { fuel_temperature_k = 300 }\ndroplets = { sauter_mean_m = 5e-4, spread = 1.3 }\ncell_m = 0.003",
        ),
        ("toluene", "droplets = { sauter_mean_m = 5e-7, spread = 20 }\ncell_m = 0.004"),
        (
            "isooctane",
            "injector = { holes = 64, hole_diameter_m = 2e-5, angle_deg = 89, rail_pressure_pa = 5e8 }\ncell_m = 0.004",
        ),
        (
            "isooctane",
            "plume = { angle_deg = 90 }\nshots = { turbulence = 2, integral_scale = 0.005, mass = 1, angle_deg = 10 }\nshot = 3\ncell_m = 0.004",
        ),
        (
            "isooctane",
            "injector = { discharge_coefficient = 0.05, velocity_coefficient = 1, hole_diameter_m = 2e-3 }\ncell_m = 0.004",
        ),
    ];
    for (fuel, text) in cases {
        // Nothing but the first two is about time.
        let time = if text.starts_with("time_s") { "" } else { "time_s = 2e-4\n" };
        let mut source = multi_hole(&format!("{time}{text}"));
        source.fuel = fuel.to_owned();
        let ParametricSpray { field, summary, .. } = made(&source);
        let mass = (summary.liquid_kg + summary.vapour_kg) / summary.injected_kg;
        // Shots change masses.
        assert!(mass.is_finite() && (source.shot.is_some() || (mass - 1.0).abs() < 1e-6), "{text}: {mass}");
        assert!(field.deposit_per_m3.iter().all(|d| d.is_finite() && *d >= 0.0), "{text}");
        for gas in &field.gas {
            assert!(gas.vapour_mol_m3.is_finite() && gas.vapour_mol_m3 >= 0.0, "{text}: {gas:?}");
            assert!((200.0..=700.0 + 1e-6).contains(&gas.temperature_k), "{text}: {gas:?}");
        }
        let hottest = source.gas.temperature_k.max(source.injector.feed().fuel_temperature_k);
        for parcel in &field.parcels {
            assert!(parcel.diameter_m > 0.0 && parcel.diameter_m < 0.01, "{text}: {parcel:?}");
            assert!((219.0..=hottest + 1e-6).contains(&parcel.temperature_k), "{text}: {parcel:?}");
            assert!(parcel.droplets.is_finite() && parcel.droplets > 0.0, "{text}: {parcel:?}");
        }
    }
    for text in [
        "time_s = 2e-4\ninjector = { cone_angle_deg = 175, sheet_thickness_m = 2e-6 }\ncell_m = 0.002",
        "time_s = 2e-4\ninjector = { cone_angle_deg = 5, pintle_diameter_m = 0.05, sheet_thickness_m = 1e-3 }\ncell_m = 0.003",
    ] {
        let summary = made(&hollow_cone(text)).summary;
        assert!(
            ((summary.liquid_kg + summary.vapour_kg) / summary.injected_kg - 1.0).abs() < 1e-6,
            "{summary:?}"
        );
    }
}
