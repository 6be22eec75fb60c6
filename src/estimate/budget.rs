//! What a map's temperatures may be wrong by, part by part and pixel by pixel.
//!
//! Two parts are statistical and make up `sigma_temperature_k`: the camera's noise and the shots' own scatter. The others
//! are systematic: one unknown number each, common to all pixels and not made smaller by more shots. They follow from
//! I_cal(T_eff) = ε_B·S + R·I_cal(T_wall), a line through x = γ_far·I_cal(T_plate), by small changes. What nobody has
//! stated is not in the budget, and named.

use super::calibration::CalibrationFit;
use super::map::DitMap;
use rayon::prelude::*;

/// Pixels of one piece of work.
const PIECE: usize = 4096;

/// Standard deviations of what is only stated; None where nobody has.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stated {
    /// Of γ_near.
    pub gamma_near: Option<f64>,
    /// Of γ_far.
    pub gamma_far: Option<f64>,
    /// Of the far window's reflectance.
    pub reflectance_far: Option<f64>,
    /// Of the walls' temperature, in K.
    pub wall_temperature_k: Option<f64>,
    /// Of ε_B.
    pub emissivity_plate: Option<f64>,
    /// Of the plate's temperature over its surface, in K.
    pub plate_uniformity_k: Option<f64>,
    /// Of the plate's reading against the true scale, in K, common to calibration and campaign.
    pub plate_reading_k: Option<f64>,
}

/// What the systematic parts follow from.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    /// The curve with its covariance.
    pub fit: &'a CalibrationFit,
    /// γ_near.
    pub gamma_near: f64,
    /// γ_far.
    pub gamma_far: f64,
    /// Reflectance of the far window.
    pub reflectance_far: f64,
    /// Temperature of the walls that it mirrors, in K.
    pub wall_temperature_k: f64,
    /// ε_B.
    pub emissivity_plate: f64,
    /// Plate at each level, in K; None for a level that is left out.
    pub plates_k: &'a [Option<f64>],
    /// What is stated of all that.
    pub stated: Stated,
}

/// One part of the budget.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Name of its channel.
    pub name: &'static str,
    /// What it is of.
    pub of: &'static str,
    /// Whether it is common to all pixels and does not average out.
    pub systematic: bool,
    /// Standard deviation of the temperature, in K, `[rows · columns]`; NaN where there is no temperature.
    pub sigma_k: Vec<f64>,
}

/// The parts of a map's uncertainty.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Budget {
    /// Parts, the camera's noise aside, which is a channel of every map; the last is the square sum of all.
    pub parts: Vec<Part>,
    /// What is not in it because nobody has stated it.
    pub absent: Vec<&'static str>,
    /// Systematic part of the emissivity, relative and common to all pixels: windows, calibration.
    pub emissivity_relative: Option<[f64; 2]>,
}

/// The shots' own scatter: what the camera leaves of `sigma_temperature_k`, in squares.
fn shots(map: &DitMap) -> Part {
    let each = map.sigma_temperature_k.iter().zip(&map.sigma_t_noise_k);
    Part {
        name: "sigma_t_shots_k",
        of: "differences between shots",
        systematic: false,
        // NaN stays NaN; a sample that scatters less than the camera has none.
        sigma_k: each
            .map(|(&all, &noise)| {
                let rest = all * all - noise * noise;
                if rest < 0.0 { 0.0 } else { rest.sqrt() }
            })
            .collect(),
    }
}

/// The statistical parts alone: of frames whose windows, plate and curve are taken as they are stated.
pub fn statistical(map: &DitMap) -> Budget {
    let shots = shots(map);
    let total = Part { sigma_k: map.sigma_temperature_k.clone(), ..total() };
    Budget {
        parts: vec![shots, total],
        absent: vec!["calibration", "windows", "plate emissivity and uniformity", "plate reading"],
        emissivity_relative: None,
    }
}

fn total() -> Part {
    Part {
        name: "sigma_t_total_k",
        of: "all parts together, in squares",
        systematic: false,
        sigma_k: Vec::new(),
    }
}

/// All parts. `shares` is [`super::map::crossing_shares`] of the map's sums.
///
/// Panics when the shares belong to another map, which is the caller's mistake.
pub fn budget(map: &DitMap, shares: &[f64], setup: &Setup<'_>) -> Budget {
    let levels = setup.plates_k.len();
    assert!(shares.len() == map.temperature_k.len() * levels, "a share per pixel and level");
    let curve = CurveTerms::new(setup);
    let s = setup.stated;
    let windows = [s.gamma_far, s.reflectance_far, s.wall_temperature_k].iter().any(Option::is_some);
    let plate = s.emissivity_plate.is_some() || s.plate_uniformity_k.is_some();
    let wanted: [(&str, &str, &str, bool); 4] = [
        ("sigma_t_calibration_k", "the calibration curve", "calibration", true),
        ("sigma_t_windows_k", "transmittance and light of the windows", "windows", windows),
        (
            "sigma_t_plate_k",
            "the plate's emissivity and uniformity",
            "plate emissivity and uniformity",
            plate,
        ),
        ("sigma_t_reading_k", "the plate's reading", "plate reading", s.plate_reading_k.is_some()),
    ];
    let pixels = map.temperature_k.len();
    let mut planes: [Vec<f64>; 4] = std::array::from_fn(|_| vec![f64::NAN; pixels]);
    let [first, second, third, fourth] = &mut planes;
    first
        .par_chunks_mut(PIECE)
        .zip(second.par_chunks_mut(PIECE))
        .zip(third.par_chunks_mut(PIECE).zip(fourth.par_chunks_mut(PIECE)))
        .enumerate()
        .for_each(|(piece, ((calibration, windows), (plate, reading)))| {
            for i in 0..calibration.len() {
                let pixel = piece * PIECE + i;
                if map.temperature_k[pixel].is_finite() {
                    let shares = &shares[pixel * levels..(pixel + 1) * levels];
                    [calibration[i], windows[i], plate[i], reading[i]] =
                        setup.parts(&curve, map.crossing[pixel], shares);
                }
            }
        });
    let mut squares: Vec<f64> = map.sigma_temperature_k.iter().map(|sigma| sigma * sigma).collect();
    let mut parts = vec![shots(map)];
    let mut absent = Vec::new();
    for ((name, of, short, known), sigma_k) in wanted.into_iter().zip(planes) {
        if known {
            squares.iter_mut().zip(&sigma_k).for_each(|(sum, sigma)| *sum += sigma * sigma);
            parts.push(Part { name, of, systematic: true, sigma_k });
        } else {
            absent.push(short);
        }
    }
    parts.push(Part { sigma_k: squares.into_iter().map(f64::sqrt).collect(), ..total() });
    Budget { parts, absent, emissivity_relative: Some(setup.emissivity_relative()) }
}

/// What the parts need of the curve at the plates and the walls, the same for all pixels.
struct CurveTerms {
    /// Per level: d(counts)/d(parameters), and counts per kelvin.
    plates: Vec<([f64; 3], f64)>,
    /// Counts of a wall, their gradient, and counts per kelvin.
    wall: (f64, [f64; 3], f64),
}

impl CurveTerms {
    fn new(setup: &Setup<'_>) -> Self {
        let fit = setup.fit;
        let equation = |kelvin| fit.residual.as_ref().map_or(kelvin, |residual| residual.undo(kelvin));
        let at = |kelvin: f64| (fit.gradient(equation(kelvin)), fit.derivative(kelvin));
        let (gradient, per_k) = at(setup.wall_temperature_k);
        Self {
            plates: setup.plates_k.iter().map(|plate| plate.map_or(([0.0; 3], 0.0), at)).collect(),
            wall: (fit.counts(setup.wall_temperature_k), gradient, per_k),
        }
    }
}

impl Setup<'_> {
    /// Standard deviations of the temperature, in K, of a pixel whose line crosses zero at `crossing`: calibration,
    /// windows, plate, reading.
    fn parts(&self, curve: &CurveTerms, crossing: f64, shares: &[f64]) -> [f64; 4] {
        let (fit, s) = (self.fit, self.stated);
        let plate = self.emissivity_plate;
        let (wall, wall_gradient, wall_per_k) = curve.wall;
        let counts = plate * crossing + self.reflectance_far * wall;
        let equation = fit.curve.inverse(counts);
        let corrected = fit.residual.as_ref().map_or(1.0, |residual| residual.apply(equation).1);
        let per_count = fit.curve.inverse_derivative(counts, equation) * corrected;
        // An error of the curve moves the plates' x, the walls' light and the reading of the temperature together.
        let own = fit.gradient(equation);
        let mut gradient: [f64; 3] =
            std::array::from_fn(|i| self.reflectance_far * wall_gradient[i] - own[i]);
        let mut counts_per_plate_k = 0.0;
        for ((of_plate, per_k), share) in curve.plates.iter().zip(shares) {
            let share = plate * self.gamma_far * share;
            gradient.iter_mut().zip(of_plate).for_each(|(sum, g)| *sum += share * g);
            counts_per_plate_k += share * per_k;
        }
        let calibration = fit.variance_of(&gradient).sqrt() * per_count;
        let far = plate * crossing * s.gamma_far.unwrap_or(0.0) / self.gamma_far;
        let mirror = wall * s.reflectance_far.unwrap_or(0.0);
        let walls = self.reflectance_far * wall_per_k * s.wall_temperature_k.unwrap_or(0.0);
        let windows = far.hypot(mirror).hypot(walls) * per_count;
        let uneven = counts_per_plate_k * s.plate_uniformity_k.unwrap_or(0.0);
        let plate = (crossing * s.emissivity_plate.unwrap_or(0.0)).hypot(uneven) * per_count;
        // Curve and line are in the plate's own kelvins: what they are off goes over one to one.
        [calibration, windows, plate, s.plate_reading_k.unwrap_or(0.0)]
    }

    /// Relative standard deviation of all emissivities together: by the windows, by the curve between the coldest and the
    /// hottest plate.
    fn emissivity_relative(&self) -> [f64; 2] {
        let (near, far) = (self.stated.gamma_near.unwrap_or(0.0), self.stated.gamma_far.unwrap_or(0.0));
        let plates = || self.plates_k.iter().copied().flatten();
        let (cold, hot) = (plates().fold(f64::INFINITY, f64::min), plates().fold(0.0, f64::max));
        let span = self.fit.counts(hot) - self.fit.counts(cold);
        let (hot, cold) = (self.fit.gradient(hot), self.fit.gradient(cold));
        let curve = self.fit.variance_of(&std::array::from_fn(|i| hot[i] - cold[i])).sqrt();
        [(near / self.gamma_near).hypot(far / self.gamma_far), if span > 0.0 { curve / span } else { 0.0 }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::calibration::{CalibrationPoint, OffsetMode, SakumaHattori, fit_curve};

    const TRUTH: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };

    const PLATES_K: [Option<f64>; 5] = [Some(373.0), Some(413.0), Some(453.0), Some(493.0), Some(533.0)];

    fn fit() -> CalibrationFit {
        let points: Vec<CalibrationPoint> = (0..10)
            .map(|i| {
                let temperature_k = 340.0 + 30.0 * f64::from(i);
                let counts = TRUTH.value(temperature_k);
                CalibrationPoint { temperature_k, counts, sigma_counts: 0.15 + 1e-3 * counts }
            })
            .collect();
        fit_curve(&points, OffsetMode::Free).unwrap()
    }

    fn setup(fit: &CalibrationFit) -> Setup<'_> {
        Setup {
            fit,
            gamma_near: 0.94,
            gamma_far: 0.95,
            reflectance_far: 0.05,
            wall_temperature_k: 523.0,
            emissivity_plate: 0.96,
            plates_k: &PLATES_K,
            stated: Stated {
                gamma_near: Some(0.003),
                gamma_far: Some(0.004),
                reflectance_far: Some(0.002),
                wall_temperature_k: Some(2.0),
                emissivity_plate: Some(0.01),
                plate_uniformity_k: Some(0.2),
                plate_reading_k: Some(0.3),
            },
        }
    }

    /// The whole measurement of a pixel of emissivity one, noise-free: what `seen` makes of plates between 373 K and
    /// 533 K when `taken` is taken for the world.
    fn measured(world: &Setup<'_>, taken: &Setup<'_>, shift_k: f64) -> f64 {
        let plates = PLATES_K.map(|plate| plate.unwrap());
        let spray = TRUTH.value(455.0);
        let truth = |t: f64| TRUTH.value(t);
        let far = world.reflectance_far * truth(world.wall_temperature_k) / world.emissivity_plate;
        // I_cal of the world scales with its ε_B; the reading of the plate is `shift_k` too low.
        let y: Vec<f64> = plates
            .iter()
            .map(|&t| {
                let plate = world.gamma_far * truth(t + shift_k) + far;
                spray / world.emissivity_plate - plate
            })
            .collect();
        let x: Vec<f64> = plates.iter().map(|&t| taken.gamma_far * taken.fit.counts(t)).collect();
        let line = crate::estimate::line::weighted(&x, &y, &[1.0; 5]).unwrap();
        let wall = taken.fit.counts(taken.wall_temperature_k);
        taken.fit.temperature(taken.emissivity_plate * line.crossing + taken.reflectance_far * wall)
    }

    /// The parts of that pixel: shares of an unweighted line.
    fn parts(taken: &Setup<'_>) -> [f64; 4] {
        let crossing = (TRUTH.value(455.0) - 0.05 * TRUTH.value(523.0)) / 0.96;
        let x = PLATES_K.map(|plate| taken.gamma_far * TRUTH.value(plate.unwrap()));
        let mean = x.iter().sum::<f64>() / 5.0;
        let spread: f64 = x.iter().map(|x| (x - mean) * (x - mean)).sum();
        let shares = x.map(|x| 0.2 + (crossing - mean) * (x - mean) / spread);
        taken.parts(&CurveTerms::new(taken), crossing, &shares)
    }

    /// Each systematic part is what the whole measurement is off by when its cause is off by one standard deviation.
    #[test]
    fn parts_are_what_the_measurement_is_off_by() {
        let fit = fit();
        let taken = setup(&fit);
        let at = measured(&taken, &taken, 0.0);
        assert!((at - 455.0).abs() < 0.02, "{at}");
        let [_, windows, plate, reading] = parts(&taken);
        let off = |world: &Setup<'_>| measured(world, &taken, 0.0) - at;
        let s = taken.stated;
        let far = off(&Setup { gamma_far: 0.95 + 0.004, ..taken });
        let mirror = off(&Setup { reflectance_far: 0.05 + 0.002, ..taken });
        let walls = off(&Setup { wall_temperature_k: 525.0, ..taken });
        let all = far.hypot(mirror).hypot(walls);
        // Small changes leave out their second order: half a per cent for half a per cent.
        assert!((windows / all - 1.0).abs() < 0.02, "{windows} {all}");
        let paint = measured(&Setup { emissivity_plate: 0.96 + 0.01, ..taken }, &taken, 0.0) - at;
        let uneven = measured(&taken, &taken, 0.2) - at;
        assert!((plate / paint.hypot(uneven) - 1.0).abs() < 0.02, "{plate} {paint} {uneven}");
        assert!((reading - s.plate_reading_k.unwrap()).abs() < 1e-12);
    }

    /// The calibration's part against draws of the points: 300 calibrations, the measurement made with each and the part that
    /// each tells. What clean points tell is what points alone are worth: more than noisy ones, which are drawn to what bands have.
    #[test]
    fn calibration_part_is_the_scatter_of_calibrations() {
        let fit = fit();
        let taken = setup(&fit);
        let [calibration, ..] = parts(&taken);
        let mut state = 3_u64;
        let mut normal = move || {
            let sum: f64 = (0..12)
                .map(|_| {
                    state =
                        state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    f64::from(u32::try_from(state >> 32).unwrap()) / 4_294_967_296.0
                })
                .sum();
            sum - 6.0
        };
        let (mut squares, mut told) = (0.0, 0.0);
        for _ in 0..300 {
            let points: Vec<CalibrationPoint> = (0..10)
                .map(|i| {
                    let temperature_k = 340.0 + 30.0 * f64::from(i);
                    let sigma_counts = 0.15 + 1e-3 * TRUTH.value(temperature_k);
                    let counts = TRUTH.value(temperature_k) + sigma_counts * normal();
                    CalibrationPoint { temperature_k, counts, sigma_counts }
                })
                .collect();
            let drawn = fit_curve(&points, OffsetMode::Free).unwrap();
            let drawn = Setup { fit: &drawn, ..taken };
            squares += (measured(&taken, &drawn, 0.0) - 455.0).powi(2);
            told += parts(&drawn)[0].powi(2);
        }
        let (scatter, told) = ((squares / 300.0_f64).sqrt(), (told / 300.0_f64).sqrt());
        eprintln!("calibration {calibration:.4} K, told {told:.4} K, scatter {scatter:.4} K");
        // A standard deviation of 300 draws is good to 4 %: five of its own. Linearity costs a few per cent, and what comes
        // from bands counts twice in the variance, up to 1.41 times.
        assert!((0.8..1.7).contains(&(told / scatter)), "{told} {scatter}");
        assert!(calibration > 0.95 * told, "{calibration} {told}");
    }
}
