//! What a perfect experiment in the simulated world would find, and what is really there.
//!
//! *Statistical truth*: the mean of spray − blank over infinitely many injections of the declared law, without
//! noise, rounding, left-over vapour or drift, at the true plate temperatures. The estimator fits it like data; what
//! is left between that and a measured map is the error of the measurement. *Physical truth*: the temperature and
//! the emissivity of the medium along the straight sight, absorption- and transmission-weighted; what is left
//! between both truths is the error of the method (scattering, walls, non-gray band).
//!
//! All pixels have the same marginal law and the images are piecewise linear in one variable, so that each pixel
//! needs only the mean weight of each knot (and of knot × temperature shift), which depends on its optical depth
//! alone: those serve every plate temperature, group and truth. The mean over the temperature shift at given
//! optical depth is taken in closed form, the mean over the optical depth by scrambled nets. Fits nothing.

use super::RigError;
use super::chamber::World;
use super::level::{DIFFERENCE, Images, Level, PLATE_SLOPE, SHIFT, SHIFT_SQUARED};
use super::radiometry::Optics;
use super::sights::{Emission, KNOTS_MAX, Sights, class_depth, place};
use rayon::prelude::*;

/// Below this mean absorptance a pixel has no physical temperature: NaN.
const ABSORPTANCE_MIN: f64 = 1e-6;
/// Newton steps at most for a physical temperature; in ln L against 1/T two or three are usual.
const STEPS_MAX: usize = 12;

/// How fine the mean over injections is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sampling {
    /// Low-discrepancy injections of one replicate.
    pub points: usize,
    /// Independent scrambles, two at least: their scatter is the standard error.
    pub replicates: usize,
}

/// Both truths of one world. Every array is per active pixel (see `pixels`); NaN means "has none".
#[derive(Debug, Clone)]
pub struct Truth {
    /// Rows of the image.
    pub rows: usize,
    /// Columns of the image.
    pub columns: usize,
    /// Linear indices of the active pixels, ascending; in all others spray and blank are equal.
    pub pixels: Vec<u32>,
    /// The true plate temperatures, in kelvin.
    pub plate_k: Vec<f64>,
    /// Statistical truth.
    pub statistical: Statistical,
    /// Physical truth of all species.
    pub physical: Physical,
    /// Physical truth of the droplets alone; all NaN without their channels.
    pub droplets: Physical,
    /// Pixels whose physical temperature did not converge in the steps allowed (they are NaN).
    pub unresolved: usize,
}

/// The mean of perfect shots.
#[derive(Debug, Clone, Default)]
pub struct Statistical {
    /// Expected spray − blank in counts of nominal gain, `[level][active pixel]`.
    pub difference_counts: Vec<Vec<f64>>,
    /// Standard error of it from the replicates, in counts, `[level][active pixel]`.
    pub standard_error_counts: Vec<Vec<f64>>,
    /// Expected blank in counts without offset, `[level][active pixel]`.
    pub blank_counts: Vec<Vec<f64>>,
    /// Mean a_plate over shots and band (weighted by the light of a black body at the mean plate temperature),
    /// `[active pixel]`; the emissivity of DIT is one minus it where the plate fills the pixel.
    pub a_plate: Vec<f64>,
}

/// What is there along the straight sight.
#[derive(Debug, Clone, Default)]
pub struct Physical {
    /// T such that the same absorbing mass at the uniform temperature T would send as many electrons along the
    /// straight sight: Σ_g q_g E[d0_g] B_g(T) = Σ_g q_g E[d1_g], in kelvin, `[active pixel]`. For a narrow band
    /// it is the inverse of the weighted mean of I_BB(T(s)); unlike that it is exact for an isothermal medium
    /// whatever the spectrum.
    pub temperature_k: Vec<f64>,
    /// Mean absorptance along the straight sight, weighted by black-body light of that temperature, `[active
    /// pixel]`.
    pub emissivity: Vec<f64>,
}

impl Truth {
    /// Takes the means. `plate_k` are the true plate temperatures, in kelvin.
    ///
    /// # Errors
    /// [`RigError::Config`] for fewer than two replicates, no points or no plate temperature.
    pub fn new(
        world: &World,
        plate_k: &[f64],
        integration_s: f64,
        sampling: Sampling,
    ) -> Result<Self, RigError> {
        if sampling.replicates < 2 || sampling.points == 0 || plate_k.is_empty() {
            let why = "two replicates, one point and one plate temperature at least".to_owned();
            return Err(RigError::Config { key: "rig.truth".to_owned(), why });
        }
        let (sights, optics) = (world.sights(), world.optics());
        let levels = plate_k.iter().map(|&t| Level::at(sights, optics, t)).collect::<Result<Vec<_>, _>>()?;
        let mean_k = plate_k.iter().sum::<f64>() / plate_k.len() as f64;
        let question = Question {
            sights,
            optics,
            levels: &levels,
            plate_k,
            counts_per_rate: integration_s / optics.electrons_per_count(),
            weights: class_weights(sights, &Replicate::all(world, sampling)),
            plate_weights: (0..optics.groups())
                .map(|g| optics.inside_sensitivity(g) * optics.black(g, mean_k))
                .collect(),
        };
        let answers: Vec<Answer> = (0..sights.pixels().len())
            .into_par_iter()
            .with_min_len(256)
            .map(|i| question.answer(i))
            .collect();
        Ok(Self::gather(sights, plate_k, &answers))
    }

    /// An image `[row, column]` of one of the arrays, with `fill` in pixels without medium.
    pub fn image(&self, values: &[f64], fill: f64) -> Vec<f64> {
        let mut image = vec![fill; self.rows * self.columns];
        for (&pixel, &value) in self.pixels.iter().zip(values) {
            image[pixel as usize] = value;
        }
        image
    }

    fn gather(sights: &Sights, plate_k: &[f64], answers: &[Answer]) -> Self {
        let per_level = |f: &dyn Fn(&LevelAnswer) -> f64| -> Vec<Vec<f64>> {
            (0..plate_k.len()).map(|k| answers.iter().map(|a| f(&a.levels[k])).collect()).collect()
        };
        let physical = |f: &dyn Fn(&Answer) -> Sight| Physical {
            temperature_k: answers.iter().map(|a| f(a).temperature_k).collect(),
            emissivity: answers.iter().map(|a| f(a).emissivity).collect(),
        };
        Self {
            rows: sights.rows(),
            columns: sights.columns(),
            pixels: sights.pixels().to_vec(),
            plate_k: plate_k.to_vec(),
            statistical: Statistical {
                difference_counts: per_level(&|l| l.difference),
                standard_error_counts: per_level(&|l| l.standard_error),
                blank_counts: per_level(&|l| l.blank),
                a_plate: answers.iter().map(|a| a.a_plate).collect(),
            },
            physical: physical(&|a| a.all),
            droplets: physical(&|a| a.droplets),
            unresolved: answers.iter().filter(|a| a.all.unresolved || a.droplets.unresolved).count(),
        }
    }
}

/// Injections of one replicate: factor on the optical depth, mean and mean square of the temperature shift.
struct Replicate(Vec<[f64; 3]>);

impl Replicate {
    fn all(world: &World, sampling: Sampling) -> Vec<Self> {
        let Some(law) = world.law() else { return vec![Self(vec![[1.0, 0.0, 0.0]])] };
        (0..sampling.replicates as u64)
            .map(|r| {
                let points = law.marginal(r, sampling.points);
                Self(points.into_iter().map(|[ln, k, k2]| [libm::exp(ln), k, k2]).collect())
            })
            .collect()
    }

    /// Mean weight of each knot of a pixel, alone and times the shift and its square.
    fn weights(&self, depth: f32, knots: &[f32]) -> Weights {
        let mut weights = [[0.0; 3]; KNOTS_MAX];
        for &[factor, shift, shift_squared] in &self.0 {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "the interpolation variable is f32 in shots too"
            )]
            let v = -libm::expm1f(-depth * factor as f32);
            let (k, part) = place(knots, v);
            let part = f64::from(part);
            for (knot, weight) in [(k, 1.0 - part), (k + 1, part)] {
                weights[knot][0] += weight;
                weights[knot][1] += weight * shift;
                weights[knot][2] += weight * shift_squared;
            }
        }
        let share = 1.0 / self.0.len() as f64;
        weights.map(|w| w.map(|x| x * share))
    }
}

fn class_weights(sights: &Sights, replicates: &[Replicate]) -> Vec<Vec<Weights>> {
    let classes = sights.depth_classes();
    let mut used = vec![false; classes.iter().max().map_or(0, |&c| usize::from(c) + 1)];
    classes.iter().for_each(|&c| used[usize::from(c)] = true);
    let of = |(class, used): (usize, &bool)| -> Vec<Weights> {
        let class = u16::try_from(class).expect("classes are counted in 16 bits");
        let weights = |r: &Replicate| r.weights(class_depth(class), sights.class_knots(class));
        if *used { replicates.iter().map(weights).collect() } else { Vec::new() }
    };
    used.par_iter().enumerate().map(of).collect()
}

type Weights = [[f64; 3]; KNOTS_MAX];

struct Question<'a> {
    sights: &'a Sights,
    optics: &'a Optics,
    levels: &'a [Level],
    plate_k: &'a [f64],
    counts_per_rate: f64,
    /// `[depth class][replicate]`; empty for classes without a pixel.
    weights: Vec<Vec<Weights>>,
    plate_weights: Vec<f64>,
}

struct Answer {
    levels: Vec<LevelAnswer>,
    a_plate: f64,
    all: Sight,
    droplets: Sight,
}

struct LevelAnswer {
    difference: f64,
    standard_error: f64,
    blank: f64,
}

#[derive(Clone, Copy)]
struct Sight {
    temperature_k: f64,
    emissivity: f64,
    unresolved: bool,
}

impl Sight {
    const NONE: Self = Self { temperature_k: f64::NAN, emissivity: f64::NAN, unresolved: false };
}

impl Question<'_> {
    fn answer(&self, i: usize) -> Answer {
        let each = &self.weights[usize::from(self.sights.depth_classes()[i])];
        let mean = mean_weights(each);
        let groups = 0..self.optics.groups();
        let all: Vec<_> = groups.clone().map(|g| self.sights.direct(i, g)).collect();
        let droplets: Option<Vec<_>> = groups.map(|g| self.sights.direct_droplets(i, g)).collect();
        Answer {
            levels: (0..self.levels.len()).map(|k| self.level(i, k, each)).collect(),
            a_plate: self.a_plate(i, &mean),
            all: self.sight(&all, &mean),
            droplets: droplets.map_or(Sight::NONE, |d| self.sight(&d, &mean)),
        }
    }

    fn level(&self, i: usize, k: usize, each: &[Weights]) -> LevelAnswer {
        let level = &self.levels[k];
        let step = self.plate_k[k] - level.reference_k();
        let images = level.images(i);
        let of = |weights: &Weights| -> f64 {
            images.iter().zip(weights).map(|(image, w)| difference(image, w, step)).sum()
        };
        let values: Vec<f64> = each.iter().map(|w| of(w) * self.counts_per_rate).collect();
        let (difference, standard_error) = mean_and_error(&values);
        let seen = f64::from(self.sights.plate_seen(i));
        let blank = level.blank_electrons_per_s(seen, self.plate_k[k]) * self.counts_per_rate;
        LevelAnswer { difference, standard_error, blank }
    }

    fn a_plate(&self, i: usize, mean: &Weights) -> f64 {
        let (mut through, mut all) = (0.0, 0.0);
        for (g, weight) in self.plate_weights.iter().enumerate() {
            let coefficients = self.sights.coefficients(i, g);
            let expected: f64 = coefficients.iter().zip(mean).map(|(c, w)| c.plate * w[0]).sum();
            through += weight * expected;
            all += weight;
        }
        through / all
    }

    /// Temperature and emissivity of the mean emission along the straight sight, `[group][knot]`.
    fn sight(&self, emission: &[[Emission; KNOTS_MAX]], mean: &Weights) -> Sight {
        let expected: Vec<[f64; 2]> = emission.iter().map(|knots| expected_emission(knots, mean)).collect();
        let sensitivity = |g: usize| self.optics.inside_sensitivity(g);
        let (mut absorbed, mut all, mut light) = (0.0, 0.0, 0.0);
        for (g, [weight, radiance]) in expected.iter().enumerate() {
            absorbed += sensitivity(g) * weight;
            all += sensitivity(g);
            light += sensitivity(g) * radiance;
        }
        if absorbed < ABSORPTANCE_MIN * all || light <= 0.0 {
            return Sight::NONE;
        }
        let emitted = |t: f64| -> f64 {
            let of = |(g, e): (usize, &[f64; 2])| sensitivity(g) * e[0] * self.optics.black(g, t);
            expected.iter().enumerate().map(of).sum()
        };
        let Some(temperature_k) = temperature_of(light, &emitted) else {
            return Sight { unresolved: true, ..Sight::NONE };
        };
        let black = self.optics.groups();
        let black: f64 = (0..black).map(|g| sensitivity(g) * self.optics.black(g, temperature_k)).sum();
        Sight { temperature_k, emissivity: emitted(temperature_k) / black, unresolved: false }
    }
}

fn difference(image: &Images, [one, shift, shift_squared]: &[f64; 3], step: f64) -> f64 {
    let at = |i: usize| f64::from(image[i]);
    one * (at(DIFFERENCE) + step * at(PLATE_SLOPE)) + shift * at(SHIFT) + shift_squared * at(SHIFT_SQUARED)
}

fn expected_emission(knots: &[Emission; KNOTS_MAX], mean: &Weights) -> [f64; 2] {
    knots.iter().zip(mean).fold([0.0; 2], |[weight, light], (e, [one, shift, shift_squared])| {
        [weight + one * e.weight, light + one * e.calm + shift * e.shift + shift_squared * e.shift_squared]
    })
}

/// Solves `emitted(T) = light` by secants in ln L against 1/T, where Planck's law is nearly straight.
fn temperature_of(light: f64, emitted: &dyn Fn(f64) -> f64) -> Option<f64> {
    let residual = |t: f64| libm::log(emitted(t) / light);
    let (mut a, mut b) = (1.0 / 400.0, 1.0 / 500.0);
    let (mut fa, mut fb) = (residual(1.0 / a), residual(1.0 / b));
    for _ in 0..STEPS_MAX {
        // d ln L / d ln T is about ten: 1e-12 is a temperature to 1e-13 relative.
        if fb.abs() < 1e-12 {
            return Some(1.0 / b);
        }
        let next = b - fb * (b - a) / (fb - fa);
        if !(next > 0.0 && next.is_finite()) {
            return None;
        }
        (a, fa) = (b, fb);
        (b, fb) = (next, residual(1.0 / next));
    }
    None
}

fn mean_weights(each: &[Weights]) -> Weights {
    let mut mean = [[0.0; 3]; KNOTS_MAX];
    let share = 1.0 / each.len() as f64;
    for weights in each {
        for (sum, w) in mean.iter_mut().zip(weights) {
            for (s, x) in sum.iter_mut().zip(w) {
                *s += share * x;
            }
        }
    }
    mean
}

/// Mean of replicates and its standard error; zero for a single one (a law without chance).
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    if values.len() < 2 {
        return (mean, 0.0);
    }
    let squares: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
    (mean, libm::sqrt(squares / (n - 1.0) / n))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::chamber::{Moment, Target};
    use crate::rig::detector::Exposure;
    use crate::rig::level::Illumination;
    use crate::rig::sample;

    const SAMPLING: Sampling = Sampling { points: 128, replicates: 8 };
    const PLATES: [f64; 3] = [393.1, 449.0, 513.0];

    /// The mean of 3000 simulated shots without detector noise is the statistical truth, within five standard
    /// errors of that mean (from its own scatter).
    #[test]
    fn many_shots_tend_to_the_statistical_truth() {
        let world = sample::world(&sample::Choices::usual());
        let truth = Truth::new(&world, &PLATES, 25e-6, SAMPLING).unwrap();
        let n = 3000_u32;
        for (k, &plate_k) in PLATES.iter().enumerate() {
            let light = Illumination { plate_k, integration_s: 25e-6, vapour_depth: 0.0 };
            let exposure = Exposure { ordinal: 0, at_s: 0.0, since_pause: 9 };
            let expected = |target| world.expected_electrons(&Moment { target, light, exposure });
            let blank = expected(Target::Blank);
            let mut sums = vec![[0.0_f64; 2]; truth.pixels.len()];
            for injection in 0..u64::from(n) {
                let spray = expected(Target::Spray { injection });
                for (sum, &p) in sums.iter_mut().zip(&truth.pixels) {
                    let y = f64::from(spray[p as usize] - blank[p as usize]) / 427.0;
                    sum[0] += y;
                    sum[1] += y * y;
                }
            }
            let n = f64::from(n);
            for (i, [sum, squares]) in sums.into_iter().enumerate() {
                let mean = sum / n;
                let error = ((squares / n - mean * mean) / n).sqrt();
                let expected = truth.statistical.difference_counts[k][i];
                // 2e-5 of a blank of 30 … 250 counts: the expansion around a multiple of 0.25 K, and f32.
                let blank = truth.statistical.blank_counts[k][i];
                assert!((mean - expected).abs() < 5.0 * error + 3e-5 * blank, "{k} {i}: {mean} {expected}");
                assert!(truth.statistical.standard_error_counts[k][i] < 0.1 * error + 1e-9, "{k} {i}");
            }
        }
    }

    /// One temperature in the medium and no fluctuation of it: the physical truth is that temperature, however
    /// non-gray the medium; f32 channels limit it to 1e-7 / 10 relative.
    #[test]
    fn isothermal_medium_has_its_own_temperature() {
        let choices =
            sample::Choices { fluctuation: Some(sample::LAW_WITHOUT_SHIFT), ..sample::Choices::usual() };
        let truth = Truth::new(&sample::world(&choices), &PLATES, 25e-6, SAMPLING).unwrap();
        assert_eq!(truth.unresolved, 0);
        for sight in [&truth.physical, &truth.droplets] {
            for &t in &sight.temperature_k {
                assert!((t - 430.0).abs() < 2e-5, "{t}");
            }
        }
        let (all, drops) = (&truth.physical.emissivity, &truth.droplets.emissivity);
        for (a, d) in all.iter().zip(drops) {
            assert!((0.0..=1.0).contains(a) && (d / a - 0.5).abs() < 1e-5);
        }
    }

    /// Radiance is convex in temperature: fluctuating temperatures raise the intensity-averaged one by
    /// (x − 2)/T · σ²/2 with x = hc/(λkT), for 5 K at 430 K and 3.40 µm by 0.228 K; the next order is (σ·x/T)²
    /// of it, 1.3 %.
    #[test]
    fn fluctuating_temperature_raises_the_mean() {
        let law = crate::rig::config::FluctuationConfig { correlation: 0.0, ..sample::LAW };
        let choices = sample::Choices { fluctuation: Some(law), ..sample::Choices::usual() };
        let truth = Truth::new(&sample::world(&choices), &PLATES, 25e-6, SAMPLING).unwrap();
        for &t in &truth.physical.temperature_k {
            assert!((t - 430.228).abs() < 0.004, "{t}");
        }
    }

    #[test]
    fn world_without_fluctuation_is_its_own_truth() {
        let choices = sample::Choices { fluctuation: None, ..sample::Choices::usual() };
        let world = sample::world(&choices);
        let truth = Truth::new(&world, &[450.0], 25e-6, SAMPLING).unwrap();
        let light = Illumination { plate_k: 450.0, integration_s: 25e-6, vapour_depth: 0.0 };
        let exposure = Exposure { ordinal: 0, at_s: 0.0, since_pause: 9 };
        let frame = |target| world.expected_electrons(&Moment { target, light, exposure });
        let (spray, blank) = (frame(Target::Spray { injection: 0 }), frame(Target::Blank));
        let image = truth.image(&truth.statistical.difference_counts[0], 0.0);
        for (p, expected) in image.iter().enumerate() {
            // Two f32 numbers of up to 3e4 electrons are subtracted.
            assert!((f64::from(spray[p] - blank[p]) / 427.0 - expected).abs() < 2e-5, "{p}");
        }
        let op = sample::operator(&choices, 1.0);
        for (i, a) in truth.statistical.a_plate.iter().enumerate() {
            let (low, high) = op.a_plate[i * 4..i * 4 + 4]
                .iter()
                .fold((f64::MAX, f64::MIN), |(l, h), &x| (l.min(f64::from(x)), h.max(f64::from(x))));
            assert!((low - 1e-6..=high + 1e-6).contains(a), "{low} {a} {high}");
        }
    }

    #[test]
    fn truth_has_the_same_bits_for_any_number_of_threads() {
        let world = sample::world(&sample::Choices::usual());
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Truth::new(&world, &PLATES, 25e-6, SAMPLING).unwrap())
        };
        let bits = |t: &Truth| -> Vec<u64> {
            let counts = t.statistical.difference_counts.iter().flatten();
            counts.chain(&t.physical.temperature_k).map(|x| x.to_bits()).collect()
        };
        assert_eq!(bits(&with(1)), bits(&with(3)));
    }

    #[test]
    fn too_few_replicates_are_refused() {
        let world = sample::world(&sample::Choices::usual());
        assert!(Truth::new(&world, &PLATES, 25e-6, Sampling { points: 8, replicates: 1 }).is_err());
        assert!(Truth::new(&world, &[], 25e-6, SAMPLING).is_err());
    }
}
