//! Pictures of Mie theory: what droplets of one liquid do to light of one wavelength, and tables of spheres.

use super::plot::polar::{Curve, Polar};
use super::plot::sheet::{Drawing, Sheet};
use super::plot::{Plot, Point, Scale, Series, Style};
use ditd_sim::light::mie::{self, Direction, Efficiencies, MieError, Sphere};
use std::f64::consts::PI;

/// Radii of the curves. Lines narrower than the step (resonances without absorption) are sampled, not resolved.
const RADII: u32 = 800;
/// Steps of the scattering angle for a size parameter up to 50; twice as many for each doubling of that.
const ANGLES: u32 = 360;
/// … and at most this many.
const ANGLES_MAX: u32 = 5760;
/// Ratios of scattering to absorption up to this are drawn on a linear axis; of larger ones the small would vanish.
const RATIO_LINEAR_MAX: f64 = 10.0;

/// Droplets of one liquid in light of one wavelength.
#[derive(Debug, Clone, PartialEq)]
pub struct Droplets {
    /// What the liquid is, for the title.
    pub name: String,
    /// Real part of the index.
    pub n: f64,
    /// Imaginary part, not negative.
    pub k: f64,
    /// Wavelength in µm.
    pub wavelength_um: f64,
    /// Smallest and largest radius in µm.
    pub radius_um: (f64, f64),
    /// Radii in µm whose phase function is drawn.
    pub patterns_um: Vec<f64>,
}

impl Droplets {
    fn sphere(&self, radius_um: f64) -> Sphere {
        Sphere { size_parameter: 2.0 * PI * radius_um / self.wavelength_um, n: self.n, k: self.k }
    }
}

/// Up to four radii of one digit (1, 2 or 5 times a power of ten) spread over a range, for the phase functions: not
/// beyond a size parameter of 20, where a pattern is a spike and a comb. The middle when none lies there.
pub fn round_radii((low, high): (f64, f64), wavelength_um: f64) -> Vec<f64> {
    let high = high.min((20.0 * wavelength_um / (2.0 * PI)).max(low));
    let mut round: Vec<f64> = (-12..12)
        .flat_map(|decade| [1.0, 2.0, 5.0].map(|digit| digit * libm::pow(10.0, f64::from(decade))))
        .filter(|r| *r >= low * (1.0 - 1e-9) && *r <= high * (1.0 + 1e-9))
        .collect();
    if round.is_empty() {
        round.push((low * high).sqrt());
    }
    let last = round.len() - 1;
    let mut chosen: Vec<f64> = (0..4).map(|i| round[(i * last + 1) / 3]).collect();
    chosen.dedup();
    chosen
}

/// The page of a liquid: efficiencies, scattering over absorption and mean cosine against the radius, phase functions.
///
/// # Errors
///
/// What Mie theory says of a sphere it cannot compute.
pub fn sheet(droplets: &Droplets) -> Result<Sheet, MieError> {
    let (low, high) = droplets.radius_um;
    let radii: Vec<f64> =
        (0..=RADII).map(|i| low * libm::pow(high / low, f64::from(i) / f64::from(RADII))).collect();
    let spheres: Vec<Sphere> = radii.iter().map(|&radius| droplets.sphere(radius)).collect();
    let answers = mie::efficiencies_of_many(&spheres).map_err(|(_, error)| error)?;
    let curve = |value: fn(&Efficiencies) -> f64| -> Vec<Point> {
        radii.iter().zip(&answers).map(|(&radius, q)| Point::new(radius, value(q))).collect()
    };
    let line = |name: &str, value| Series { name: name.into(), points: curve(value), style: Style::Line };
    let over_radius = |y_label: &str, series| Plot {
        x_label: "radius / µm".into(),
        y_label: y_label.into(),
        x_scale: Scale::Log,
        series,
        ..Plot::default()
    };
    let efficiencies = Plot {
        zero: true,
        ..over_radius(
            "cross-section / geometric cross-section",
            vec![line("Q ext", |q| q.q_ext), line("Q sca", |q| q.q_sca), line("Q abs", |q| q.q_abs)],
        )
    };
    let ratio = curve(|q| q.q_sca / q.q_abs);
    let largest = ratio.iter().map(|p| p.y).filter(|y| y.is_finite()).fold(0.0, f64::max);
    let ratio_scale = if largest > RATIO_LINEAR_MAX { Scale::Log } else { Scale::Linear };
    let ratio = Plot {
        zero: ratio_scale == Scale::Linear,
        y_scale: ratio_scale,
        ..over_radius(
            "scattering / absorption, Q sca / Q abs",
            vec![Series { name: String::new(), points: ratio, style: Style::Line }],
        )
    };
    let asymmetry = Plot { zero: true, ..over_radius("mean cosine g", vec![line("", |q| q.asymmetry)]) };
    // Where nothing is absorbed there is no ratio.
    let mut drawings = vec![Drawing::Plot(efficiencies)];
    if largest > 0.0 {
        drawings.push(Drawing::Plot(ratio));
    }
    drawings.extend([Drawing::Plot(asymmetry), Drawing::Polar(patterns(droplets)?)]);
    Ok(Sheet {
        title: format!(
            "{}: m = {} + {} i, λ = {} µm",
            droplets.name,
            digits(droplets.n),
            digits(droplets.k),
            digits(droplets.wavelength_um)
        ),
        drawings,
        columns: 2,
    })
}

/// Five significant digits at most.
fn digits(value: f64) -> String {
    let rounded: f64 = format!("{value:.4e}").parse().unwrap_or(value);
    if rounded != 0.0 && rounded.abs() < 1e-4 { format!("{rounded:e}") } else { format!("{rounded}") }
}

fn patterns(droplets: &Droplets) -> Result<Polar, MieError> {
    let mut curves = Vec::new();
    for &radius in &droplets.patterns_um {
        let sphere = droplets.sphere(radius);
        let mut angles = ANGLES;
        while f64::from(angles) < 7.2 * sphere.size_parameter && angles < ANGLES_MAX {
            angles *= 2;
        }
        let theta: Vec<f64> = (0..=angles).map(|i| 180.0 * f64::from(i) / f64::from(angles)).collect();
        let towards =
            theta.iter().map(|&t| Direction::from_degrees(t)).collect::<Result<Vec<_>, MieError>>()?;
        let phase = mie::phase(sphere, &towards)?;
        curves.push(Curve {
            name: format!("r = {} µm", digits(radius)),
            points: theta.into_iter().zip(phase).collect(),
        });
    }
    Ok(Polar { label: "phase function p₁₁".into(), curves })
}

/// The plot of a table of spheres with their efficiencies against x; joined by lines when all have one index.
pub fn spheres(spheres: &[Sphere], answers: &[Efficiencies]) -> Plot {
    let mut order: Vec<usize> = (0..spheres.len()).collect();
    order.sort_by(|&a, &b| spheres[a].size_parameter.total_cmp(&spheres[b].size_parameter));
    let one_index = spheres
        .windows(2)
        .all(|pair| pair[0].n.to_bits() == pair[1].n.to_bits() && pair[0].k.to_bits() == pair[1].k.to_bits());
    let style = if one_index { Style::Line } else { Style::Dots };
    let series = |name: &str, value: fn(&Efficiencies) -> f64| Series {
        name: name.into(),
        points: order.iter().map(|&i| Point::new(spheres[i].size_parameter, value(&answers[i]))).collect(),
        style,
    };
    let above = spheres.iter().map(|s| s.size_parameter).filter(|x| *x > 0.0);
    let (low, high) = above.fold((f64::INFINITY, 0.0f64), |span, x| (span.0.min(x), span.1.max(x)));
    let wide = |low: f64, high: f64| if high > 10.0 * low { Scale::Log } else { Scale::Linear };
    let x_scale = wide(low, high);
    // Efficiencies of small spheres span many decades; those that can be seen on a linear axis get one.
    let extinctions = answers.iter().map(|q| q.q_ext).filter(|q| *q > 0.0);
    let (low, high) = extinctions.fold((f64::INFINITY, 0.0f64), |span, q| (span.0.min(q), span.1.max(q)));
    let y_scale = if high > 300.0 * low { Scale::Log } else { Scale::Linear };
    Plot {
        x_label: "size parameter x = 2πr/λ".into(),
        y_label: "cross-section / geometric cross-section".into(),
        x_scale,
        y_scale,
        series: vec![
            series("Q ext", |q| q.q_ext),
            series("Q sca", |q| q.q_sca),
            series("Q abs", |q| q.q_abs),
        ],
        zero: true,
        ..Plot::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn droplets(k: f64) -> Droplets {
        Droplets {
            name: "a liquid".into(),
            n: 1.38,
            k,
            wavelength_um: 3.4,
            radius_um: (0.1, 50.0),
            patterns_um: round_radii((0.1, 50.0), 3.4),
        }
    }

    #[test]
    fn the_page_of_a_liquid_holds_its_four_drawings() {
        let page = sheet(&droplets(0.09)).unwrap();
        assert_eq!(page.drawings.len(), 4);
        assert_eq!(page.title, "a liquid: m = 1.38 + 0.09 i, λ = 3.4 µm");
        let Drawing::Plot(ratio) = &page.drawings[1] else { panic!("a plot") };
        // The paper's statement: largest where the diameter is about the wavelength.
        let peak = ratio.series[0].points.iter().max_by(|a, b| a.y.total_cmp(&b.y)).unwrap();
        assert!((1.7..2.5).contains(&peak.x) && (2.123..2.2).contains(&peak.y), "{peak:?}");
        let svg = page.to_svg();
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        // Without absorption the ratio has no value: the rest stays.
        let page = sheet(&droplets(0.0)).unwrap();
        let svg = page.to_svg();
        assert!(page.drawings.len() == 3 && !svg.contains("no data"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        assert!(sheet(&Droplets { k: -1.0, ..droplets(0.0) }).is_err());
    }

    #[test]
    fn patterns_are_of_round_radii() {
        let close = |a: &[f64], b: &[f64]| {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a / b - 1.0).abs() < 1e-12)
        };
        let found = round_radii((0.1, 50.0), 3.4);
        assert!(close(&found, &[0.1, 0.5, 2.0, 10.0]), "{found:?}");
        assert!(close(&round_radii((3.0, 4.0), 3.4), &[12f64.sqrt()]));
        assert!(close(&round_radii((1.0, 1.5), 3.4), &[1.0]));
        assert!(close(&round_radii((100.0, 400.0), 3.4), &[100.0]));
        assert!(round_radii((0.01, 1000.0), 10.0).len() == 4);
    }

    #[test]
    fn tables_of_one_index_are_lines_on_fitting_axes() {
        let own = |x: f64, n: f64| Sphere { size_parameter: x, n, k: 0.1 };
        let plot = |table: &[Sphere]| spheres(table, &mie::efficiencies_of_many(table).unwrap());
        let wide = plot(&[own(30.0, 1.4), own(0.0, 1.4), own(0.01, 1.4)]);
        assert!(
            wide.x_scale == Scale::Log && wide.y_scale == Scale::Log && wide.series[0].style == Style::Line
        );
        assert!(wide.series[0].points.is_sorted_by(|a, b| a.x <= b.x));
        let narrow = plot(&[own(3.0, 1.4), own(4.0, 1.5)]);
        assert!(narrow.x_scale == Scale::Linear && narrow.y_scale == Scale::Linear);
        assert!(narrow.series[0].style == Style::Dots);
        assert!(!plot(&[]).to_svg().contains("NaN"));
    }
}
