//! Ray mode: time against error of lists of rays through slabs and a grid whose answers are known from elsewhere.

use super::super::{Figure, Watch};
use super::curves::{Findings, Page, alone, log_log, marked, rms};
use crate::report::plot::{Point, Series};
use ditd_sim::light::phase::PhaseFunction;
use ditd_sim::tracer::error::TracerError;
use ditd_sim::tracer::medium::GridMedium;
use ditd_sim::tracer::plate::{Plate, PlateShape};
use ditd_sim::tracer::rays::{RayAnswer, RayOptions, render_rays};
use ditd_sim::tracer::shape::{Body, Shape, ShapeMedium};

const TARGETS: [f64; 5] = [1e-3, 3e-4, 1e-4, 3e-5, 1e-5];

/// A list of rays has few numbers: it is run with further seeds until this time has passed, s, …
const SECONDS: f64 = 3.0;
/// … or so often.
const SEEDS_MAX: u64 = 12;

/// Cosines of the rays through slabs.
const COSINES: [f64; 4] = [1.0, 0.9, 0.6, 0.2];

/// A slab of optical depth and albedo, plate within a cone; a_plate and a_walls of each cosine to 1e-9, by matrix
/// exponentials, doubling and PythonicDISORT (`sim/tests/data/rte/README.md`, cases 2, 7, 9 and 17).
struct Slab {
    name: &'static str,
    asymmetry: f64,
    albedo: f64,
    depth: f64,
    cone_cosine: f64,
    truth: [[f64; 2]; 4],
}

const SLABS: [Slab; 4] = [
    Slab {
        name: "isotropic, albedo 0.999, τ 10",
        asymmetry: 0.0,
        albedo: 0.999,
        depth: 10.0,
        cone_cosine: 0.0,
        truth: [
            [0.138_246_051_83, 0.838_875_535_307],
            [0.129_747_920_407, 0.848_306_492_487],
            [0.104_120_057_258, 0.877_128_467_501],
            [0.068_765_045_932_4, 0.917_846_331_244],
        ],
    },
    Slab {
        name: "g 0.5, albedo 0.999, τ 50",
        asymmetry: 0.5,
        albedo: 0.999,
        depth: 50.0,
        cone_cosine: 0.0,
        truth: [
            [0.034_454_822_625_2, 0.873_520_372_478],
            [0.032_320_660_335_8, 0.880_729_052_106],
            [0.025_829_017_770_9, 0.903_194_077_679],
            [0.016_611_111_771_8, 0.936_489_623_212],
        ],
    },
    Slab {
        name: "g 0.9, albedo 0.9, τ 5",
        asymmetry: 0.9,
        albedo: 0.9,
        depth: 5.0,
        cone_cosine: 0.0,
        truth: [
            [0.463_177_057_592, 0.055_985_222_533_9],
            [0.417_909_480_278, 0.067_353_766_673_9],
            [0.272_424_188_621, 0.120_602_039_994],
            [0.120_215_982_86, 0.294_118_748_688],
        ],
    },
    Slab {
        name: "g 0.9, albedo 0.6, τ 4, plate of 18°",
        asymmetry: 0.9,
        albedo: 0.6,
        depth: 4.0,
        cone_cosine: 0.95,
        truth: [
            [0.098_804_279_648_4, 0.073_653_667_623_9],
            [0.020_872_227_817_8, 0.123_258_136_428],
            [0.003_535_047_250_44, 0.073_167_552_827_3],
            [0.001_050_588_738_82, 0.094_273_230_678_3],
        ],
    },
];

/// Rays (x, z) along y through the case "jets", with a_plate and a_walls to 2.5e-5, by regular and delta tracking
/// (`sim/tests/data/rte/README.md`): targets far above that can be measured.
const JETS: [([f64; 2], [f64; 2]); 3] = [
    ([0.36, 0.01], [0.041_026_6, 0.069_154_3]),
    ([-0.28, 0.3], [0.085_939_1, 0.088_877_5]),
    ([0.07, -0.4], [0.373_906_2, 0.092_221_1]),
];
const JETS_TARGETS: [f64; 3] = [1e-3, 3e-4, 1e-4];

/// Rays with what is known of them.
struct Case<'a> {
    name: &'a str,
    body: &'a Body<'a>,
    plate: Plate,
    rays: Vec<([f64; 3], [f64; 3])>,
    truth: Vec<[f64; 2]>,
}

/// Time against error of every list.
pub(super) fn rays(watch: &Watch<'_>) -> Result<Findings, TracerError> {
    let mut findings = Findings::default();
    let mut curves = Vec::new();
    for slab in &SLABS {
        let medium = ShapeMedium {
            shape: Shape::Slab { thickness_m: 0.01, optical_depth: slab.depth },
            albedo: slab.albedo,
            phase: if slab.asymmetry > 0.0 {
                PhaseFunction::HenyeyGreenstein { asymmetry: slab.asymmetry }
            } else {
                PhaseFunction::Isotropic
            },
        };
        let half_angle_deg = libm::acos(slab.cone_cosine).to_degrees();
        let case = Case {
            name: slab.name,
            body: &Body::shape(&medium)?,
            plate: Plate::new(&PlateShape::Cone { facing: [0.0, 0.0, 1.0], half_angle_deg })?,
            rays: COSINES.map(|mu| ([0.0, 0.0, 1.0], [(1.0 - mu * mu).sqrt(), 0.0, -mu])).to_vec(),
            truth: slab.truth.to_vec(),
        };
        curves.push(front(watch, &case, &TARGETS, &mut findings.figures)?);
    }
    let (medium, plate) = jets();
    let case = Case {
        name: "grid of 24³ cells, two jets",
        body: &Body::grid(&medium, 0)?,
        plate: Plate::new(&plate)?,
        rays: JETS.map(|([x, z], _)| ([x, -3.0, z], [0.0, 1.0, 0.0])).to_vec(),
        truth: JETS.map(|(_, truth)| truth).to_vec(),
    };
    curves.push(front(watch, &case, &JETS_TARGETS, &mut findings.figures)?);
    findings.fronts.push(Series { name: format!("rays, {}", SLABS[2].name), ..curves[2].clone() });
    findings.fronts.push(Series { name: format!("rays, {}", case.name), ..curves[4].clone() });
    findings.pages.push(Page {
        name: "render_rays",
        sheet: alone(
            "ray mode: targets of 1e-3 to 1e-5",
            log_log("time of a ray / s", "true rms error of the coefficients", curves),
        ),
    });
    Ok(findings)
}

/// Error against the time of one ray, for each target.
fn front(
    watch: &Watch<'_>,
    case: &Case<'_>,
    targets: &[f64],
    figures: &mut Vec<Figure>,
) -> Result<Series, TracerError> {
    let mut points = Vec::new();
    for &target in targets {
        let (mut runs, mut seconds) = (Vec::new(), 0.0);
        for seed in 1..=SEEDS_MAX {
            let options = RayOptions { target_error: target, seed, ..RayOptions::default() };
            let mut answers = Ok(Vec::new());
            seconds += watch
                .best_of(1, || answers = render_rays(case.body, &case.rays, Some(&case.plate), &options));
            runs.push(answers?);
            if seconds > SECONDS {
                break;
            }
        }
        #[expect(clippy::cast_precision_loss, reason = "a few runs and rays")]
        let (number, rays) = (runs.len() as f64, case.rays.len() as f64);
        let figure = figure(case, target, seconds / number, &runs);
        eprintln!("{}: {:.3} s, {:.1e}, {}", figure.name, figure.seconds, figure.error, figure.error_kind);
        points.push(Point::new(seconds / number / rays, figure.error));
        figures.push(figure);
    }
    Ok(marked(case.name, points))
}

fn figure(case: &Case<'_>, target: f64, seconds: f64, runs: &[Vec<RayAnswer>]) -> Figure {
    let each = || runs.iter().flat_map(|answers| answers.iter().zip(&case.truth));
    let error = rms(each().flat_map(|(ray, truth)| [ray.plate - truth[0], ray.walls - truth[1]]));
    let declared = rms(each().flat_map(|(ray, _)| [ray.se_plate, ray.se_walls]));
    let worst = each().fold(0.0_f64, |worst, (ray, _)| worst.max(ray.se_plate).max(ray.se_walls));
    let missed = if worst > target { "; the target was not reached within the limits" } else { "" };
    Figure {
        name: format!("rays, {}, target {target:.0e}", case.name),
        seconds,
        error,
        error_kind: format!(
            "a_plate and a_walls, rms of {} runs, whose mean time this is; declared {declared:.1e}, at most {worst:.1e}{missed}",
            runs.len()
        ),
        n: case.rays.len(),
        threads: rayon::current_num_threads(),
        seed: Some(1),
    }
}

/// The case "jets": two Gaussian columns along z in 24³ cells, g 0.8, albedo 0.5.
fn jets() -> (GridMedium, PlateShape) {
    let n = 24_u32;
    let place = |i: u32| -1.0 + f64::from(2 * i + 1) / f64::from(n);
    let k_ext: Vec<f64> = (0..n * n * n)
        .map(|i| {
            let (x, y) = (place(i / (n * n)), place(i / n % n));
            let column = |x0: f64, y0: f64, width: f64| {
                libm::exp(-((x - x0).powi(2) + (y - y0).powi(2)) / (2.0 * width * width))
            };
            12.0 * column(0.35, 0.0, 0.15) + 7.0 * column(-0.3, 0.2, 0.2)
        })
        .collect();
    let half: Vec<f64> = k_ext.iter().map(|k| 0.5 * k).collect();
    let medium = GridMedium {
        lower_m: [-1.0; 3],
        upper_m: [1.0; 3],
        cells: [n as usize; 3],
        groups: 1,
        channels: 1,
        index: (0..n * n * n).collect(),
        k_ext,
        k_sca: half.clone(),
        emission: half,
        phase: vec![PhaseFunction::HenyeyGreenstein { asymmetry: 0.8 }],
    };
    let plate = PlateShape::Rectangle {
        centre_m: [0.0, 2.0, 0.0],
        facing: [0.0, -1.0, 0.0],
        width_m: 1.6,
        height_m: 1.6,
    };
    (medium, plate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_jets_are_those_of_the_reference() {
        // The sum of all extinctions and the transmission of the first ray, from the table's README and row.
        let (medium, _) = jets();
        let sum: f64 = medium.k_ext.iter().sum();
        assert!((sum / 11_941.588_359_779_77 - 1.0).abs() < 1e-12, "{sum}");
        let depth = Body::grid(&medium, 0).unwrap().optical_depth([0.36, -3.0, 0.01], [0.0, 1.0, 0.0]);
        assert!(((-depth).exp() - 0.011_545_089_024_7).abs() < 1e-12, "{depth}");
    }

    #[test]
    fn errors_of_lists_are_those_of_the_answers() {
        let clock = crate::clock::Clock::start();
        let watch = Watch { clock: &clock, seconds: 0.0 };
        let mut figures = Vec::new();
        let (medium, plate) = jets();
        let case = Case {
            name: "jets",
            body: &Body::grid(&medium, 0).unwrap(),
            plate: Plate::new(&plate).unwrap(),
            rays: vec![([JETS[0].0[0], -3.0, JETS[0].0[1]], [0.0, 1.0, 0.0])],
            truth: vec![JETS[0].1],
        };
        let curve = front(&watch, &case, &[1e-2], &mut figures).unwrap();
        // Three standard errors of up to twelve runs of two numbers.
        assert!(figures[0].error < 3e-2 && curve.points.len() == 1 && figures[0].n == 1, "{figures:?}");
        assert!(curve.points[0].x > 0.0);
        // A truth that is off by 0.3 is seen.
        let wrong = Case { truth: vec![[0.341, 0.369]], ..case };
        front(&watch, &wrong, &[1e-2], &mut figures).unwrap();
        assert!((figures[1].error - 0.3).abs() < 0.05, "{figures:?}");
    }
}
