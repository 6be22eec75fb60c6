//! The phase function of a whole spray at one wavelength: mean of the Mie patterns, weighted with scattering.

use super::super::field::Parcel;
use super::droplets::{counts, whole};
use crate::light::fuel::Fuel;
use crate::light::mie::{self, Sphere};
use crate::light::phase::{PhaseFunction, mie as mie_phase};
use std::f64::consts::PI;

/// Width of a class of diameters in ln d.
const CLASS: f64 = 0.05;
/// Sizes that stand for a class: from, to. A parcel stands for droplets of nearly its diameter, never of exactly it.
const SIZES: [usize; 2] = [1, 256];
/// Diameters narrower than this in ln d are one size.
const ONE_SIZE: f64 = 1e-9;

/// The phase function of parcels at one wavelength with what is known about it.
#[derive(Debug, Clone)]
pub(super) struct Mean {
    pub(super) phase: PhaseFunction,
    /// Nodes of the phase function.
    pub(super) nodes: usize,
    /// Exact mean cosine, and that of the phase function.
    pub(super) asymmetry: f64,
    pub(super) asymmetry_tabulated: f64,
    /// Error of the cumulative distribution: of the nodes, and of the sizes by their last doubling.
    pub(super) error: f64,
    /// Mie calculations it took.
    pub(super) spheres: usize,
}

impl Mean {
    /// Of a group whose phase function is not computed.
    pub(super) fn given(phase: PhaseFunction) -> Self {
        let mean = phase.mean_cosine();
        Self { phase, nodes: 0, asymmetry: mean, asymmetry_tabulated: mean, error: 0.0, spheres: 0 }
    }
}

/// The mean phase function of parcels at one wavelength, to `target` in the cumulative distribution; isotropic when
/// nothing scatters.
pub(super) fn mean_phase(parcels: &[Parcel], fuel: &Fuel, um: f64, target: f64) -> Mean {
    let classes = Classes::new(parcels);
    let area: f64 = classes.areas.iter().sum();
    if area <= 0.0 {
        return Mean::given(PhaseFunction::Isotropic);
    }
    let warm: f64 = parcels.iter().filter(|p| counts(p)).map(|p| p.area_m2() * p.temperature_k).sum();
    let (n, k) = fuel.liquid_index(um, warm / area);
    let (sum, error) = classes.converged(um, n, k, target);
    // Judged by its own mean cosine: one that is off from the exact one is an error to report, no reason to scatter
    // isotropically.
    let own = sum.pattern.mean_cosine();
    let exact = sum.forward / sum.scattered;
    match mie_phase::of_pattern(&sum.pattern, own, mie_phase::DISTRIBUTION_ERROR) {
        Ok(made) => Mean {
            asymmetry: exact,
            asymmetry_tabulated: made.phase.mean_cosine(),
            phase: made.phase,
            nodes: made.nodes,
            error: error + made.error + (exact - own).abs(),
            spheres: sum.spheres,
        },
        // Nothing scatters: an index of exactly 1, or one without an answer.
        Err(_) => Mean { spheres: sum.spheres, ..Mean::given(PhaseFunction::Isotropic) },
    }
}

/// Geometric area of the droplets over classes of the diameter.
struct Classes {
    /// ln d in metres at the start of the first class.
    first: f64,
    /// Width in ln d; 0 when all have one size.
    width: f64,
    areas: Vec<f64>,
}

/// Sums over spheres.
struct Sum {
    pattern: mie::Pattern,
    scattered: f64,
    forward: f64,
    spheres: usize,
}

impl Classes {
    fn new(parcels: &[Parcel]) -> Self {
        let known = || parcels.iter().filter(|parcel| counts(parcel));
        let (small, large) = known()
            .map(|p| p.diameter_m.ln())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |r, d| (r.0.min(d), r.1.max(d)));
        if small > large {
            return Self { first: 0.0, width: 0.0, areas: Vec::new() };
        }
        let width = if large - small < ONE_SIZE { 0.0 } else { CLASS };
        let mut areas = vec![0.0; if width > 0.0 { 1 + whole((large - small) / width) } else { 1 }];
        for parcel in known() {
            let class = if width > 0.0 { whole((parcel.diameter_m.ln() - small) / width) } else { 0 };
            let last = areas.len() - 1;
            areas[class.min(last)] += parcel.area_m2();
        }
        Self { first: small, width, areas }
    }

    /// With as many sizes per class as bring the error below `target`, and the error by the last doubling.
    fn converged(&self, um: f64, n: f64, k: f64, target: f64) -> (Sum, f64) {
        let mut sizes = SIZES[0];
        let mut sum = self.sum(sizes, um, n, k);
        if self.width <= 0.0 {
            return (sum, 0.0);
        }
        loop {
            // Middles of twice as many parts are all new: the mean of both uses all of them.
            sizes *= 2;
            let mut finer = self.sum(sizes, um, n, k);
            let error = finer.pattern.distance(&sum.pattern);
            finer.spheres += sum.spheres;
            if error <= target || sizes >= SIZES[1] {
                return (sum.and(finer), error);
            }
            sum = finer;
        }
    }

    /// With the middles of `sizes` parts of each class; empty where a sphere has no answer.
    fn sum(&self, sizes: usize, um: f64, n: f64, k: f64) -> Sum {
        let (mut spheres, mut numbers) = (Vec::new(), Vec::new());
        for (class, &area) in self.areas.iter().enumerate().filter(|class| *class.1 > 0.0) {
            for part in 0..sizes {
                let at = class as f64 + (part as f64 + 0.5) / sizes as f64;
                let x = PI * (self.first + self.width * at).exp() / (um * 1e-6);
                spheres.push(Sphere { size_parameter: x, n, k });
                // Number of droplets ∝ area/x².
                numbers.push(area / sizes as f64 / (x * x));
            }
        }
        let count = spheres.len();
        let (Ok(answers), Ok(pattern)) =
            (mie::efficiencies_of_many(&spheres), mie::Pattern::of(&spheres, &numbers))
        else {
            return Sum { pattern: mie::Pattern::default(), scattered: 0.0, forward: 0.0, spheres: count };
        };
        let (mut scattered, mut forward) = (0.0, 0.0);
        for ((q, sphere), number) in answers.iter().zip(&spheres).zip(&numbers) {
            let own = number * sphere.size_parameter * sphere.size_parameter * q.q_sca;
            scattered += own;
            forward += own * q.asymmetry;
        }
        Sum { pattern, scattered, forward, spheres: count }
    }
}

impl Sum {
    /// A third of this and two thirds of one with twice as many sizes, which counts the spheres of both.
    fn and(self, finer: Self) -> Self {
        Self {
            pattern: self.pattern.scaled(1.0 / 3.0).and(&finer.pattern.scaled(2.0 / 3.0)),
            scattered: (self.scattered + 2.0 * finer.scattered) / 3.0,
            forward: (self.forward + 2.0 * finer.forward) / 3.0,
            spheres: finer.spheres,
        }
    }
}
