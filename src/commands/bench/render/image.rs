//! Image mode: time against error, and what becomes of both with the size, depth, albedo and band of the scene.

use super::super::{Figure, Watch};
use super::curves::{Findings, Page, Sample, beside, line, log_log, marked, rms, sweep};
use super::judge::{Judges, Scrutiny, Verdict, spread};
use super::plumes::{Plumes, STANDARD, STANDARD_FULL, camera, plate};
use crate::report::plot::{Point, Series};
use ditd_sim::tracer::error::TracerError;
use ditd_sim::tracer::image::{RenderOptions, render_image};
use ditd_sim::tracer::medium::GridMedium;
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::reference::render_reference;
use ditd_sim::tracer::relight::Lighting;

const SEED: u64 = 1;

/// Target of the sweeps, the default of images.
const TARGET: f64 = 1e-3;

/// Targets of the front.
const TARGETS: [f64; 6] = [4e-2, 1e-2, 4e-3, 2e-3, 1e-3, 5e-4];
const TARGETS_FULL: [f64; 3] = [4e-3, 2e-3, 1e-3];
const TARGETS_STRAIGHT: [f64; 4] = [4e-3, 1e-3, 3e-4, 1e-4];
const TARGETS_REFERENCE: [f64; 4] = [1e-2, 5e-3, 2.5e-3, 1.25e-3];

/// How closely scenes are looked at: the standard one, those without scattering, and others.
const STANDARD_SCRUTINY: Scrutiny = Scrutiny { pixels: 1500, target: 2.5e-4, paths_max: 1 << 22 };
const STRAIGHT_SCRUTINY: Scrutiny = Scrutiny { pixels: 1500, target: 3e-5, paths_max: 1 << 16 };
const SWEEP_SCRUTINY: Scrutiny = Scrutiny { pixels: 700, target: 1e-3, paths_max: 1 << 20 };

/// Runs of one figure, fewer if they are long: …
const RUNS: u32 = 3;
/// … no further one once they have taken so long, s.
const RUNS_SECONDS: f64 = 6.0;

/// The standard scene with its judges, made when it is first asked for.
#[derive(Default)]
pub(super) struct Standard(std::cell::OnceCell<(GridMedium, Judges)>);

impl Standard {
    fn get(&self) -> Result<&(GridMedium, Judges), TracerError> {
        if self.0.get().is_none() {
            let medium = STANDARD.medium()?;
            let judges = judges("standard scene", &medium, &STANDARD_SCRUTINY)?;
            // Nobody else holds the cell.
            let _ = self.0.set((medium, judges));
        }
        Ok(self.0.get().expect("it has just been set"))
    }
}

fn judges(name: &str, medium: &GridMedium, scrutiny: &Scrutiny) -> Result<Judges, TracerError> {
    let judges = Judges::new(medium, scrutiny)?;
    eprintln!("{name}: two judges, each off by {:.1e} rms", judges.own_error());
    Ok(judges)
}

/// Time against error of the whole operator, and of what is done with it.
pub(super) fn targets(watch: &Watch<'_>, standard: &Standard) -> Result<Findings, TracerError> {
    let (medium, judges) = standard.get()?;
    let mut findings = Findings::default();
    let mut samples = Vec::new();
    for target in TARGETS {
        let (seconds, image) = timed(watch, medium, target, true)?;
        let verdict = judges.verdict(&image);
        findings.figures.push(figure(&format!("operator, target {target:.0e}"), seconds, &image, &verdict));
        samples.push((target, sample(target, seconds, &image, &verdict), image.pixels.len()));
        if (target / TARGET - 1.0).abs() < 1e-9 {
            findings.figures.push(relit(watch, &image)?);
        }
    }
    let of = |value: &dyn Fn(&Sample) -> f64| -> Vec<Point> {
        samples.iter().map(|(target, s, _)| Point::new(*target, value(s))).collect()
    };
    let against_target = log_log(
        "target error",
        "rms error of the coefficients",
        vec![
            marked("true", of(&|s| s.error)),
            marked("declared", of(&|s| s.declared)),
            line("target", of(&|s| s.x)),
        ],
    );
    let front = samples.iter().map(|(_, s, _)| Point { x: s.seconds, y: s.error, sigma: s.uncertainty });
    let against_time = log_log(
        "time / s",
        "true rms error of the coefficients",
        vec![marked("whole operator, 640×512", front.collect())],
    );
    findings.pages.push(Page {
        name: "render_targets",
        sheet: beside("image mode: 128³ cells, optical depth 5, albedo 0.5", [against_time, against_target]),
    });
    findings.fronts.push(front_of("image, with scattering", &samples));
    Ok(findings)
}

/// The same through plumes that scatter along all their length.
pub(super) fn full(watch: &Watch<'_>) -> Result<Findings, TracerError> {
    let medium = STANDARD_FULL.medium()?;
    let judges = judges("full plumes", &medium, &STANDARD_SCRUTINY)?;
    let mut findings = Findings::default();
    let mut samples = Vec::new();
    for target in TARGETS_FULL {
        let (seconds, image) = timed(watch, &medium, target, true)?;
        let verdict = judges.verdict(&image);
        let name = format!("full plumes, target {target:.0e}");
        findings.figures.push(figure(&name, seconds, &image, &verdict));
        samples.push((target, sample(target, seconds, &image, &verdict), image.pixels.len()));
    }
    findings.fronts.push(front_of("image, full plumes", &samples));
    Ok(findings)
}

/// Emission and absorption alone.
pub(super) fn straight(watch: &Watch<'_>) -> Result<Findings, TracerError> {
    let medium = Plumes { albedo: 0.0, ..STANDARD }.medium()?;
    let judges = judges("no scattering", &medium, &STRAIGHT_SCRUTINY)?;
    let mut findings = Findings::default();
    let mut samples = Vec::new();
    for target in TARGETS_STRAIGHT {
        let (seconds, image) = timed(watch, &medium, target, false)?;
        let verdict = judges.verdict(&image);
        let name = format!("no scattering, target {target:.0e}");
        findings.figures.push(figure(&name, seconds, &image, &verdict));
        samples.push((target, sample(target, seconds, &image, &verdict), image.pixels.len()));
    }
    findings.fronts.push(front_of("image, no scattering", &samples));
    Ok(findings)
}

/// Pixels one by one.
pub(super) fn reference(watch: &Watch<'_>, standard: &Standard) -> Result<Findings, TracerError> {
    let (medium, judges) = standard.get()?;
    let chosen = spread(STANDARD_SCRUTINY.pixels);
    let mut findings = Findings::default();
    let mut samples = Vec::new();
    for target in TARGETS_REFERENCE {
        let options = RenderOptions { target_error: target, seed: SEED, ..RenderOptions::default() };
        let (seconds, image) = several(watch, || {
            render_reference(medium, &camera(), Some(&plate()), &options, Some(&chosen), &|_| {})
        })?;
        let verdict = judges.verdict(&image);
        findings.figures.push(figure(&format!("reference, target {target:.2e}"), seconds, &image, &verdict));
        samples.push((target, sample(target, seconds, &image, &verdict), image.pixels.len()));
    }
    findings.fronts.push(front_of("reference", &samples));
    Ok(findings)
}

/// The sample set of a band against one wavelength.
pub(super) fn bands(watch: &Watch<'_>) -> Result<Findings, TracerError> {
    let list = [1_u32, 2, 4, 8, 16, 32].map(|n| (f64::from(n), Plumes { groups: n as usize, ..STANDARD }));
    let title = "image mode against the number of wavelengths: 128³ cells, target 1e-3";
    let mut findings = swept(watch, "render_bands", title, "wavelengths", &list)?;
    findings.figures.push(one_by_one(watch, &Plumes { groups: 16, ..STANDARD }.medium()?)?);
    Ok(findings)
}

/// What a wavelength of a set costs when each is rendered alone: the mean of them.
fn one_by_one(watch: &Watch<'_>, medium: &GridMedium) -> Result<Figure, TracerError> {
    let groups = medium.groups;
    let [mut seconds, mut told] = [0.0; 2];
    let mut pixels = 0;
    for g in 0..groups {
        let of = |all: &[f64]| all.iter().skip(g).step_by(groups).copied().collect();
        let lone = GridMedium {
            groups: 1,
            index: medium.index.clone(),
            k_ext: of(&medium.k_ext),
            k_sca: of(&medium.k_sca),
            emission: of(&medium.emission),
            phase: vec![medium.phase[g].clone()],
            ..*medium
        };
        let (best, image) = timed(watch, &lone, TARGET, true)?;
        let [plate, medium] = declared(&image);
        (seconds, told, pixels) = (seconds + best, told + plate.max(medium), image.pixels.len());
    }
    #[expect(clippy::cast_precision_loss, reason = "wavelengths are few")]
    let each = 1.0 / groups as f64;
    let name = format!("a wavelength of {groups} alone, mean of all");
    eprintln!("{name}: {:.3} s", seconds * each);
    Ok(Figure {
        name,
        seconds: seconds * each,
        error: told * each,
        error_kind: "declared rms".into(),
        n: pixels,
        threads: rayon::current_num_threads(),
        seed: Some(SEED),
    })
}

/// More and more, smaller and smaller cells of the same plumes.
pub(super) fn size(watch: &Watch<'_>) -> Result<Findings, TracerError> {
    let list = [32_u32, 64, 128, 256, 512].map(|n| (f64::from(n), Plumes { cells: n as usize, ..STANDARD }));
    let title = "image mode against the size of the scene: optical depth 5, albedo 0.5, target 1e-3";
    swept(watch, "render_size", title, "cells along an edge", &list)
}

/// Denser and denser plumes.
pub(super) fn depth(watch: &Watch<'_>) -> Result<Findings, TracerError> {
    let list = [0.1, 1.0, 5.0, 20.0, 80.0].map(|depth| (depth, Plumes { depth, ..STANDARD }));
    let title = "image mode against optical depth: 128³ cells, albedo 0.5, target 1e-3";
    swept(watch, "render_depth", title, "largest optical depth of a sight", &list)
}

/// Plumes that scatter more and more; the axis is the share that is absorbed.
pub(super) fn albedo(watch: &Watch<'_>) -> Result<Findings, TracerError> {
    let list = [0.9, 0.5, 0.2, 0.1, 0.01, 0.001].map(|absorbed| {
        let albedo = 1.0 - absorbed;
        (absorbed, Plumes { albedo, ..STANDARD })
    });
    let title = "image mode against albedo: 128³ cells, optical depth 5, target 1e-3";
    swept(watch, "render_albedo", title, "1 − albedo", &list)
}

/// Scenes that differ in one respect, each with judges of its own.
fn swept(
    watch: &Watch<'_>,
    page: &'static str,
    title: &str,
    what: &str,
    list: &[(f64, Plumes)],
) -> Result<Findings, TracerError> {
    let mut findings = Findings::default();
    let mut samples = Vec::new();
    for &(x, plumes) in list {
        let name = format!("{what} {x}, target {TARGET:.0e}");
        let medium = plumes.medium()?;
        let (seconds, image) = timed(watch, &medium, TARGET, true)?;
        let verdict = judges(&name, &medium, &SWEEP_SCRUTINY)?.verdict(&image);
        findings.figures.push(figure(&name, seconds, &image, &verdict));
        if image.groups > 1 {
            findings.figures.push(relit(watch, &image)?);
        }
        samples.push(sample(x, seconds, &image, &verdict));
    }
    findings.pages.push(Page { name: page, sheet: sweep(title, what, TARGET, &samples) });
    Ok(findings)
}

/// A further frame from an operator.
fn relit(watch: &Watch<'_>, image: &Operator) -> Result<Figure, TracerError> {
    let groups = image.groups;
    let mut out = vec![0.0; image.plate_seen.len()];
    let mut failed = None;
    let mut kelvin = 1.0;
    let seconds = watch.fastest(|| {
        kelvin += 1e-3;
        let light = Lighting {
            ends: Vec::new(),
            plate: vec![3.0 * kelvin; groups],
            walls: vec![kelvin; groups],
            channel: 0,
            medium: vec![2.0; groups],
        };
        failed = failed.take().or(image.relight(&light, &mut out).err());
    });
    match failed {
        Some(e) => Err(e),
        None => Ok(Figure {
            name: format!("further frame, wavelengths {groups}"),
            seconds,
            error: 6e-8,
            error_kind: "rounding to f32, relative".into(),
            n: out.len(),
            threads: rayon::current_num_threads(),
            seed: None,
        }),
    }
}

fn timed(
    watch: &Watch<'_>,
    medium: &GridMedium,
    target_error: f64,
    scatter: bool,
) -> Result<(f64, Operator), TracerError> {
    let options = RenderOptions { target_error, scatter, seed: SEED, ..RenderOptions::default() };
    several(watch, || render_image(medium, &camera(), Some(&plate()), &options, &|_| {}))
}

/// Minimum time of a few runs, and what the last of them gave.
pub(super) fn several<T, E>(
    watch: &Watch<'_>,
    mut work: impl FnMut() -> Result<T, E>,
) -> Result<(f64, T), E> {
    let mut answer = None;
    let mut best = f64::INFINITY;
    let mut spent = 0.0;
    for _ in 0..RUNS {
        let seconds = watch.best_of(1, || answer = Some(work()));
        (best, spent) = (best.min(seconds), spent + seconds);
        if spent > RUNS_SECONDS || matches!(answer, Some(Err(_))) {
            break;
        }
    }
    answer.expect("there was at least one run").map(|answer| (best, answer))
}

/// Rms errors of a_plate and a_medium as the image declares them.
fn declared(image: &Operator) -> [f64; 2] {
    [&image.error_plate, &image.error_medium].map(|errors| rms(errors.iter().map(|&e| f64::from(e))))
}

fn sample(x: f64, seconds: f64, image: &Operator, verdict: &Verdict) -> Sample {
    let [plate, medium] = declared(image);
    let (error, uncertainty) = (verdict.worse(), verdict.uncertainty);
    Sample { x, seconds, error, uncertainty, declared: plate.max(medium) }
}

fn figure(name: &str, seconds: f64, image: &Operator, verdict: &Verdict) -> Figure {
    let ([plate, medium], [told_plate, told_medium]) = (verdict.errors, declared(image));
    let error_kind = format!(
        "a_plate {plate:.1e}, a_medium {medium:.1e} ± {:.0e} rms of {} pixels; declared {told_plate:.1e}, {told_medium:.1e}",
        verdict.uncertainty, verdict.pixels
    );
    eprintln!("{name}: {seconds:.3} s, {error_kind}");
    Figure {
        name: name.to_owned(),
        seconds,
        error: verdict.worse(),
        error_kind,
        n: image.pixels.len(),
        threads: rayon::current_num_threads(),
        seed: Some(SEED),
    }
}

/// Error against the time of one pixel.
fn front_of(name: &str, samples: &[(f64, Sample, usize)]) -> Series {
    #[expect(clippy::cast_precision_loss, reason = "pixels of an image")]
    let point = |(_, s, pixels): &(f64, Sample, usize)| Point {
        x: s.seconds / (*pixels).max(1) as f64,
        y: s.error,
        sigma: s.uncertainty,
    };
    marked(name, samples.iter().map(point).collect())
}
