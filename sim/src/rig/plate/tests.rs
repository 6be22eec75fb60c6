//! The plate against the maker's figures.

use super::*;

const ROOM_K: f64 = 296.15;

fn quiet() -> PlateModel {
    PlateModel { display_noise_k: 0.0, ..PlateModel::fluke_4181(ROOM_K) }
}

fn heated(model: PlateModel, set_point_k: f64) -> Plate {
    let mut plate = Plate::new(model, 1);
    plate.settings.set_point_k = set_point_k;
    plate.settings.output_on = true;
    plate
}

/// Seconds until the surface first passes `target_k`, in steps of one second.
fn time_to(plate: &mut Plate, target_k: f64, limit_s: u32) -> Option<f64> {
    let start_s = plate.now_s;
    let rises = plate.surface_k() < target_k;
    (1..limit_s).map(f64::from).find(|s| {
        plate.advance(start_s + s);
        (plate.surface_k() >= target_k) == rises
    })
}

/// Largest distance of the surface from a temperature within a time.
fn largest_off(plate: &mut Plate, from_k: f64, duration_s: u32) -> f64 {
    let start_s = plate.now_s;
    (1..duration_s).map(f64::from).fold(0.0, |largest: f64, s| {
        plate.advance(start_s + s);
        largest.max((plate.surface_k() - from_k).abs())
    })
}

/// The maker: 20 min from 35 to 500 °C; 40 min from 500 to 100 °C, 100 min from 500 to 35 °C (within 15 %).
#[test]
fn heating_and_cooling_take_the_makers_times() {
    let mut plate = heated(quiet(), 308.15);
    plate.advance(3600.0);
    plate.settings.set_point_k = 773.15;
    let heating_min = time_to(&mut plate, 772.65, 7200).unwrap() / 60.0;
    assert!((17.0..23.0).contains(&heating_min), "{heating_min} min");
    plate.advance(plate.now_s + 1800.0);
    plate.settings.set_point_k = 298.15;
    let first_min = time_to(&mut plate, 373.15, 20_000).unwrap() / 60.0;
    let second_min = time_to(&mut plate, 308.15, 20_000).unwrap() / 60.0;
    assert!((34.0..46.0).contains(&first_min), "{first_min} min");
    assert!((85.0..115.0).contains(&(first_min + second_min)), "{} min", first_min + second_min);
}

/// The levels of the paper's Figure 5: each overshoots, has settled ten minutes after arrival, and then stays
/// within the maker's stability.
#[test]
fn levels_overshoot_settle_and_stay_within_the_makers_stability() {
    let mut plate = heated(quiet(), 300.0);
    plate.advance(3600.0);
    for level_k in [373.0, 403.0, 433.0, 463.0, 498.0, 533.0] {
        plate.settings.set_point_k = level_k;
        let arrival_s = time_to(&mut plate, level_k - 0.5, 3600).unwrap();
        assert!((30.0..600.0).contains(&arrival_s), "{level_k}: {arrival_s} s");
        let start_s = plate.now_s;
        let peak_k = (1..600).map(f64::from).fold(0.0, |peak: f64, s| {
            plate.advance(start_s + s);
            peak.max(plate.surface_k())
        });
        let overshoot_k = peak_k - level_k;
        assert!(overshoot_k > 0.0 && overshoot_k < 5.0, "{level_k}: overshoot {overshoot_k}");
        let spec_k = stability_spec_k(level_k);
        let off_k = largest_off(&mut plate, level_k, 900);
        assert!(off_k < spec_k, "{level_k}: {off_k} K, the maker says {spec_k} K");
        assert!(off_k > 0.1 * spec_k, "{level_k}: {off_k} K, a real plate is never at rest");
        assert!(plate.is_stable());
        assert!(plate.stability_k() < spec_k);
    }
}

#[test]
fn what_it_shows_does_not_depend_on_how_often_it_is_looked_at() {
    let mut seldom = heated(PlateModel::fluke_4181(ROOM_K), 400.0);
    let mut often = seldom.clone();
    for tick in 0..20_000 {
        often.advance(f64::from(tick) * 0.0617);
    }
    let end_s = 1234.1;
    often.advance(end_s);
    seldom.advance(end_s);
    assert_eq!(seldom, often);
    assert_eq!(seldom.display_k().to_bits(), often.display_k().to_bits());
    seldom.advance(3.0);
    assert_eq!(seldom, often);
}

#[test]
fn a_state_written_down_goes_on_to_the_same_bits() {
    let mut plate = heated(PlateModel::fluke_4181(ROOM_K), 400.0);
    plate.advance(777.7);
    let text = serde_json::to_string(&plate).unwrap();
    let mut again: Plate = serde_json::from_str(&text).unwrap();
    assert_eq!(again, plate);
    again.rebase(0.0);
    again.advance(1000.0);
    plate.advance(1777.7);
    assert_eq!(again.surface_k().to_bits(), plate.surface_k().to_bits());
    assert_eq!(again.display_k().to_bits(), plate.display_k().to_bits());
}

#[test]
fn the_camera_does_not_see_the_displays_error() {
    let model = PlateModel { display_error_k: 0.5, display_error_per_k: 0.001, ..quiet() };
    let mut plate = heated(model, 423.15);
    plate.advance(5000.0);
    assert!((plate.display_k() - 423.15).abs() < 0.3);
    assert!((plate.display_k() - plate.surface_k() - 0.65).abs() < 0.01);
}

#[test]
fn the_displays_noise_has_the_spread_it_was_given() {
    let spread = |noise_k: f64| {
        let readings: Vec<f64> = (0..4000).map(|n| noise_k * gaussian(7, n)).collect();
        let mean = readings.iter().sum::<f64>() / 4000.0;
        (mean, (readings.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 3999.0).sqrt())
    };
    let (mean, sigma) = spread(1.0);
    // Five standard errors of mean and spread at 4000 numbers.
    assert!(mean.abs() < 5.0 / 63.2 && (sigma - 1.0).abs() < 5.0 / 89.4, "{mean} {sigma}");
}

#[test]
fn every_fault_shows() {
    let with = |fault| PlateModel { faults: vec![fault], ..quiet() };
    let mut swinging =
        heated(with(PlateFault::NeverSettles { from_s: 0.0, amplitude_k: 2.0, period_s: 120.0 }), 400.0);
    swinging.advance(5000.0);
    assert!(largest_off(&mut swinging, 400.0, 300) > 1.5);
    assert!(!swinging.is_stable());

    let mut frozen = heated(with(PlateFault::FrozenReading { from_s: 100.0 }), 400.0);
    frozen.advance(100.0);
    let shown_k = frozen.display_k();
    frozen.advance(2000.0);
    assert_eq!(frozen.display_k().to_bits(), shown_k.to_bits());
    assert!(frozen.surface_k() > shown_k + 50.0);

    let mut blank = heated(with(PlateFault::NanReading { from_s: 10.0, until_s: 20.0 }), 400.0);
    blank.advance(15.0);
    assert!(blank.display_k().is_nan());
    blank.advance(20.0);
    assert!(blank.display_k().is_finite());

    let mut tripped = heated(with(PlateFault::CutoutTrips { at_s: 600.0 }), 400.0);
    tripped.advance(599.0);
    assert!(!tripped.is_tripped());
    tripped.advance(5000.0);
    assert!(tripped.is_tripped() && tripped.surface_k() < 330.0);
    tripped.clear_cutout();
    tripped.advance(7000.0);
    assert!(!tripped.is_tripped() && tripped.surface_k() > 395.0);

    let mut swinging = heated(with(PlateFault::Overshoots { by_k: 8.0 }), 400.0);
    let arrival_s = time_to(&mut swinging, 400.0, 3600).unwrap();
    assert!(largest_off(&mut swinging, 400.0, 200) > 5.0);
    swinging.advance(arrival_s + 1200.0);
    assert!(largest_off(&mut swinging, 400.0, 200) < 0.3);

    let mut slow = heated(with(PlateFault::SlowHeating { from_s: 0.0, factor: 0.2 }), 400.0);
    let mut sound = heated(quiet(), 400.0);
    let slow_s = time_to(&mut slow, 390.0, 20_000).unwrap();
    assert!(slow_s > 1.5 * time_to(&mut sound, 390.0, 20_000).unwrap(), "{slow_s}");
}

#[test]
fn an_overheated_block_trips_the_cutout() {
    let mut plate = heated(quiet(), 400.0);
    plate.settings.cutout_k = 350.0;
    plate.advance(2000.0);
    assert!(plate.is_tripped());
    plate.settings.output_on = true;
    plate.advance(9000.0);
    assert!(plate.surface_k() < 330.0);
}

#[test]
fn a_model_is_read_from_a_file_and_unknown_keys_are_refused() {
    let text =
        "ambient_k = 296.0\ndisplay_error_k = 0.3\ndisplay_error_per_k = 0.002\ndisplay_noise_k = 0.005\n";
    let fault = "[[faults]]\nkind = \"slow-heating\"\nfrom_s = 10.0\nfactor = 0.5\n";
    let model: PlateModel = toml::from_str(&format!("{text}{fault}")).unwrap();
    assert_eq!(model.dynamics, PlateDynamics::fluke_4181());
    assert_eq!(model.faults, [PlateFault::SlowHeating { from_s: 10.0, factor: 0.5 }]);
    assert!(toml::from_str::<PlateModel>(&format!("{text}colour = 1\n")).is_err());
    assert!(toml::from_str::<PlateModel>(&format!("{text}{fault}until_s = 3.0\n")).is_err());
    assert!(toml::from_str::<PlateModel>("ambient_k = 296.0\n").is_err());
    assert_eq!(model.check(), Ok(()));
    let mut impossible = model.clone();
    impossible.dynamics.surface_lag_s = 0.0;
    assert!(impossible.check().unwrap_err().starts_with("surface_lag_s"));
    let impossible = PlateModel { display_error_k: f64::NAN, ..model };
    assert!(impossible.check().unwrap_err().starts_with("display_error_k"));
}
