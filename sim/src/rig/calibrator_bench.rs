//! What the tests of all simulated calibrators share: settings, a plate, and the campaign of bad answers.

use super::line::LineFault;
use super::plate::{Plate, PlateFault, PlateModel};
use ditd_drivers::instrument::{Calibrator, CalibratorSettings};
use ditd_drivers::quantity::{Kelvin, KelvinDelta};
use std::sync::{Arc, Mutex};

pub(super) fn settings() -> CalibratorSettings {
    CalibratorSettings {
        display_emissivity: 0.95,
        limit: Kelvin(560.0),
        rate_k_per_min: 100.0,
        stability: KelvinDelta(0.4),
    }
}

/// A 4181's plate in a room of 23 °C.
pub(super) fn plate(faults: Vec<PlateFault>) -> Arc<Mutex<Plate>> {
    let model = PlateModel { faults, ..PlateModel::fluke_4181(296.15) };
    Arc::new(Mutex::new(Plate::new(model, 3)))
}

/// What goes wrong on a line: answers later than the deadline by one of these times, and each other kind.
pub(super) fn bad_answers(late_s: &[f64]) -> Vec<LineFault> {
    let late = late_s.iter().map(|delay_s| LineFault::Late { every: 7, delay_s: *delay_s });
    let others =
        [LineFault::Garbled { every: 6 }, LineFault::Missing { every: 6 }, LineFault::Doubled { every: 6 }];
    late.chain(others).collect()
}

/// Sets and reads `count` times while `fault` is played: what is set is what was asked, a reading is right or an error.
/// The number of good rounds. The plate moves by at most `moves_k` during the exchanges of one reading.
pub(super) async fn assert_never_wrong(
    driver: &mut dyn Calibrator,
    plate: &Mutex<Plate>,
    fault: &LineFault,
    count: u32,
    moves_k: f64,
) -> u32 {
    let mut good = 0;
    for index in 0..count {
        // On the steps of every instrument.
        let target_k = 330.15 + f64::from(index % 10) * 7.0;
        let Ok(taken) = driver.set_point(Kelvin(target_k)).await else { continue };
        assert!((taken.0 - target_k).abs() < 0.01, "{fault:?}");
        let Ok(reading) = driver.read().await else { continue };
        let true_k = plate.lock().unwrap().surface_k();
        assert!((reading.set_point.0 - target_k).abs() < 0.01, "{fault:?}: {reading:?}, sent {target_k}");
        assert!((reading.apparent.0 - true_k).abs() < moves_k, "{fault:?}: {reading:?} {true_k}");
        assert!(!reading.tripped, "{fault:?}: {reading:?}");
        good += 1;
    }
    good
}
