//! Every kind of `ditd calibrate` on the simulated rig: what it writes is what the simulated world is made of.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::{Preset, folder, setting};
use ditd::calibrate::Calibration;
use ditd::campaign::StopFlag;
use ditd::session::{self, Figure, SessionError};
use serde_json::Value;
use std::path::Path;

fn preset() -> Preset {
    Preset::spray().with("calibration.frames", "20")
}

fn nobody(_: &str) -> Result<(), SessionError> {
    Ok(())
}

fn acquire(preset: &Preset, out: &Path, figure: &Figure) -> Result<Value, SessionError> {
    let (source, config) = preset.parsed();
    let set = setting(&source, &config, StopFlag::default());
    Ok(session::acquire_figure(&set, out, figure, &nobody)?.1)
}

fn file(out: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(out.join("calibration.json")).unwrap()).unwrap()
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key} in {value}"))
}

/// Offset, noise and flat need no curve; a curve acquired later keeps them, and a campaign of another lens is refused.
#[test]
fn one_file_collects_what_is_acquired() {
    let dir = folder();
    let out = dir.path().join("calibration");
    let preset = preset();
    let offset = acquire(&preset, &out, &Figure::Offset).unwrap();
    // 500 counts, the shutter's half count, 2 counts of wandering and 3/√768 of the pixels' own.
    assert!((number(&offset, "counts") - 500.4).abs() < 6.0, "{offset}");
    let noise = acquire(&preset, &out, &Figure::Noise).unwrap();
    let within = |value: f64, truth: f64, sigma: f64| (value - truth).abs() < 4.0 * sigma + 0.01 * truth;
    let electrons = number(&noise, "electrons_per_count");
    assert!(within(electrons, 427.0, number(&noise, "sigma_electrons_per_count")), "{noise}");
    let read = number(&noise, "read_noise_counts");
    assert!(within(read, 600.0 / 427.0, number(&noise, "sigma_read_noise_counts")), "{noise}");
    let flat = acquire(&preset, &out, &Figure::Flat).unwrap();
    assert_eq!(flat["broken_pixels"], 0);
    assert!((number(&flat, "gain_spread") / 0.01 - 1.0).abs() < 0.15, "{flat}");
    let before = file(&out);
    assert!(before.get("fit").is_none() && before["key"]["filter"].is_string());
    // A map cannot be fitted without a curve, and the message says what to do.
    let path = format!("{:?}", out.display().to_string());
    let (source, config) = preset.clone().with("optics.calibration", &path).parsed();
    let refused = session::run(&setting(&source, &config, StopFlag::default()), &dir.path().join("run"));
    let words = refused.unwrap_err().to_string();
    assert!(words.contains("--kind standard"), "{words}");
    let (source, config) = preset.parsed();
    session::calibrate(&setting(&source, &config, StopFlag::default()), &out).unwrap();
    let after = file(&out);
    assert_eq!((&after["offset"], &after["noise"]), (&before["offset"], &before["noise"]));
    let calibration: Calibration = serde_json::from_value(after).unwrap();
    assert!(calibration.figures.noise.is_some() && calibration.figures.flat.is_some());
    let other = preset.with("camera.lens", "\"50 mm\"");
    let error = acquire(&other, &out, &Figure::Offset).unwrap_err();
    assert_eq!(error.code(), 2);
    assert!(error.to_string().contains("50 mm"), "{error}");
}

/// Windows and plate: the world's transmittances, its walls' light and its paint.
#[test]
fn windows_and_plate_are_the_worlds() {
    let dir = folder();
    let out = dir.path().join("calibration");
    let preset = preset();
    let windows = acquire(&preset, &out, &Figure::Windows).unwrap();
    let (_, config) = preset.parsed();
    let world = ditd_sim::rig::build::world(
        &ditd_sim::rig::config::RigConfig { spray: None, fluctuation: None, ..config.rig.clone().unwrap() },
        ditd_sim::rig::build::View::Chamber,
        1,
        Path::new(""),
        &|_, _| {},
    )
    .unwrap();
    let (far, near) = world.optics().window_transmittances(500.0);
    let (measured, sigma) = (number(&windows, "transmittance"), number(&windows, "sigma_transmittance"));
    assert!((measured - far * near).abs() < 4.0 * sigma && sigma < 0.005, "{windows} {far} {near}");
    let light = world.optics().far_window_counts(config.camera.integration_s);
    let (measured, sigma) =
        (number(&windows, "far_window_counts"), number(&windows, "sigma_far_window_counts"));
    // The near window's own light, which the shutter does not have, is some hundredths of a count.
    assert!((measured - light).abs() < 4.0 * sigma + 0.1 * light, "{windows} {light}");
    let plate = acquire(&preset, &out, &Figure::PlateFromAmbient).unwrap();
    let (measured, sigma) = (number(&plate, "emissivity"), number(&plate, "sigma_emissivity"));
    assert!((measured - 0.959).abs() < 4.0 * sigma && sigma < 0.01, "{plate}");
    // A cavity in the plate's place.
    let cavity = dir.path().join("cavity");
    let (source, config) = preset.clone().with("rig.plate_view.emissivity", "1.0").parsed();
    session::calibrate(&setting(&source, &config, StopFlag::default()), &cavity).unwrap();
    let figure = Figure::PlateFromReference { standard: cavity, emissivity: 1.0 };
    let plate = acquire(&preset, &out, &figure).unwrap();
    let (measured, sigma) = (number(&plate, "emissivity"), number(&plate, "sigma_emissivity"));
    assert!((measured - 0.959).abs() < 4.0 * sigma && sigma < 0.01, "{plate}");
    let calibration: Calibration = serde_json::from_value(file(&out)).unwrap();
    assert!(calibration.figures.contradictions(&config).is_empty(), "{:?}", calibration.figures);
    let (_, wrong) = preset.with("optics.gamma_near", "0.80").parsed();
    assert_eq!(calibration.figures.contradictions(&wrong).len(), 1);
}

/// Today's short curve at 20 µs on a standard curve of 25 µs, end to end on the rig.
#[test]
fn todays_curve_is_mapped_end_to_end() {
    let dir = folder();
    let standard = dir.path().join("standard");
    let (source, config) = preset().parsed();
    session::calibrate(&setting(&source, &config, StopFlag::default()), &standard).unwrap();
    let short = preset()
        .with("camera.integration_s", "20e-6")
        .with("calibration.levels_k", "[363.0, 423.0, 483.0, 543.0]")
        .with("campaign.epoch", "\"2026-01-11T08:00:00Z\"");
    let (source, config) = short.parsed();
    let today = dir.path().join("today");
    let set = setting(&source, &config, StopFlag::default());
    let mapped = session::calibrate_today(&set, &today, &standard).unwrap().calibration;
    let mapping = mapped.mapping.clone().unwrap();
    let sigma = mapping.line.covariance[0][0].sqrt();
    assert!((mapping.line.gain - 0.8).abs() < 5.0 * sigma + 1e-3, "{mapping:?}");
    assert!((mapping.age_days.unwrap() - 10.0).abs() < 1e-9 && mapping.alarms().is_empty(), "{mapping:?}");
    assert!((mapped.key.integration_s - 20e-6).abs() < 1e-12);
}

/// A camera without a shutter: the offset is a parameter of the curve, and nothing of it is lost.
#[test]
fn without_a_shutter_the_offset_is_fitted() {
    let dir = folder();
    let mut table = preset().with("calibration.reference", "\"fitted\"");
    table = table.without("rig.detector.shutter_temperature_k");
    let (source, config) = table.parsed();
    let out = dir.path().join("standard");
    let made = session::calibrate(&setting(&source, &config, StopFlag::default()), &out).unwrap().calibration;
    let sigma = made.fit.covariance[3][3].sqrt();
    assert!(sigma > 0.0 && sigma < 3.0, "{sigma}");
    assert!((made.dark_counts - 500.0).abs() < 5.0 * sigma + 6.0, "{} {sigma}", made.dark_counts);
    let error = acquire(&table, &dir.path().join("other"), &Figure::Offset).unwrap_err().to_string();
    assert!(error.contains("shutter"), "{error}");
}
