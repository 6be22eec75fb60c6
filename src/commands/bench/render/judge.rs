//! What an image is measured by: some of its pixels traced one by one, twice.
//!
//! With two independent judges A and B the mean of (X − A)(X − B) is the mean square error of X whatever the noise of the
//! judges: nothing that they say of themselves is used.

use super::plumes::{camera, plate};
use ditd_sim::tracer::error::TracerError;
use ditd_sim::tracer::image::RenderOptions;
use ditd_sim::tracer::medium::GridMedium;
use ditd_sim::tracer::operator::Operator;
use ditd_sim::tracer::reference::render_reference;

/// How closely a scene is looked at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scrutiny {
    /// Pixels of the image that are looked at; those that miss the medium cost nothing and say nothing.
    pub(super) pixels: usize,
    /// Error of each pixel, of either judge, and …
    pub(super) target: f64,
    /// … its paths at most.
    pub(super) paths_max: u64,
}

/// Two independent looks at the same pixels.
pub(super) struct Judges {
    looks: [Operator; 2],
}

/// What the judges say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Verdict {
    /// Rms errors of a_plate and a_medium over the judged pixels and groups.
    pub(super) errors: [f64; 2],
    /// Standard error of the larger of them, as far as pixels err independently.
    pub(super) uncertainty: f64,
    /// Judged pixels.
    pub(super) pixels: usize,
}

impl Verdict {
    /// The larger error.
    pub(super) fn worse(&self) -> f64 {
        self.errors[0].max(self.errors[1])
    }
}

impl Judges {
    /// Looks at a scene behind the standard camera.
    pub(super) fn new(medium: &GridMedium, scrutiny: &Scrutiny) -> Result<Self, TracerError> {
        let chosen = spread(scrutiny.pixels);
        let look = |seed| {
            let options = RenderOptions {
                target_error: scrutiny.target,
                seed,
                paths_max: scrutiny.paths_max,
                ..RenderOptions::default()
            };
            render_reference(medium, &camera(), Some(&plate()), &options, Some(&chosen), &|_| {})
        };
        Ok(Self { looks: [look(1234)?, look(5678)?] })
    }

    /// Rms error of one judge, as the two differ.
    pub(super) fn own_error(&self) -> f64 {
        let [a, b] = &self.looks;
        let worst = pairs(a, b)
            .map(|(i, j)| [difference(a, i, b, j, 0), difference(a, i, b, j, 1)])
            .fold([0.0; 2], |sums, d| [sums[0] + d[0] * d[0], sums[1] + d[1] * d[1]]);
        #[expect(clippy::cast_precision_loss, reason = "some thousand pixels")]
        let count = pairs(a, b).count().max(1) as f64;
        (0.5 * worst[0].max(worst[1]) / count).sqrt()
    }

    /// Measures an image of the same scene.
    pub(super) fn verdict(&self, image: &Operator) -> Verdict {
        let [a, b] = &self.looks;
        let mut products: [Vec<f64>; 2] = Default::default();
        let mut pixels = 0;
        for (j, k) in pairs(a, b) {
            let Ok(i) = image.pixels.binary_search(&a.pixels[j]) else { continue };
            pixels += 1;
            for (row, products) in products.iter_mut().enumerate() {
                for group in 0..image.groups {
                    let [x, a, b] = [(image, i), (a, j), (b, k)].map(|(op, i)| value(op, i, row, group));
                    products.push((x - a) * (x - b));
                }
            }
        }
        let [plate, medium] = products.map(|list| mean_and_error(&list));
        let worse = if plate.0 > medium.0 { plate } else { medium };
        let errors = [plate.0.max(0.0).sqrt(), medium.0.max(0.0).sqrt()];
        // Of a root: half the relative uncertainty of the square; where the square is all noise, the root of the noise.
        let uncertainty =
            if worse.0 > worse.1 { 0.5 * worse.1 / worse.0.sqrt() } else { worse.1.max(0.0).sqrt() };
        Verdict { errors, uncertainty, pixels }
    }
}

/// Pixels over the whole image, at a step that shares no factor with its columns.
pub(super) fn spread(pixels: usize) -> Vec<u32> {
    let camera = camera();
    let all = camera.rows * camera.columns;
    let columns = camera.columns;
    let mut step = all.div_ceil(pixels.max(1)).max(1);
    while (2..=step).any(|d| step.is_multiple_of(d) && columns.is_multiple_of(d)) {
        step += 1;
    }
    (0..all).step_by(step).filter_map(|pixel| u32::try_from(pixel).ok()).collect()
}

/// The pixels that both have.
fn pairs<'a>(a: &'a Operator, b: &'a Operator) -> impl Iterator<Item = (usize, usize)> + 'a {
    a.pixels.iter().enumerate().filter_map(|(i, pixel)| Some((i, b.pixels.binary_search(pixel).ok()?)))
}

/// a_plate (row 0) or a_medium (row 1) of an active pixel.
fn value(image: &Operator, pixel: usize, row: usize, group: usize) -> f64 {
    f64::from(match row {
        0 => image.a_plate[pixel * image.groups + group],
        _ => image.emission[pixel * image.channels * image.groups + group],
    })
}

/// Root mean square over the groups of the difference of two pixels.
fn difference(a: &Operator, i: usize, b: &Operator, j: usize, row: usize) -> f64 {
    let square = |g: usize| (value(a, i, row, g) - value(b, j, row, g)).powi(2);
    #[expect(clippy::cast_precision_loss, reason = "groups are few")]
    let groups = a.groups as f64;
    ((0..a.groups).map(square).sum::<f64>() / groups).sqrt()
}

/// Mean and its standard error.
#[expect(clippy::cast_precision_loss, reason = "some thousand values")]
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n.max(1.0);
    let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    (mean, (square / (n * (n - 1.0)).max(1.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixels 0, 1, 2 … with these plates and no emission.
    fn image(plates: &[f32]) -> Operator {
        Operator {
            groups: 1,
            channels: 1,
            pixels: (0..).zip(plates).map(|(i, _)| i).collect(),
            a_plate: plates.to_vec(),
            emission: vec![0.0; plates.len()],
            ..Operator::default()
        }
    }

    #[test]
    fn noise_of_the_judges_cancels() {
        // Truth 0.5 everywhere, judges that err by ± 0.1 in all four combinations, an image that errs by 0.01.
        let signs = |one: [f32; 4]| image(&one.map(|s| 0.5 + 0.1 * s).repeat(25));
        let judges = Judges { looks: [signs([1.0, 1.0, -1.0, -1.0]), signs([1.0, -1.0, 1.0, -1.0])] };
        assert!((judges.own_error() - 0.1).abs() < 1e-6);
        let verdict = judges.verdict(&image(&[0.51; 100]));
        assert!((verdict.errors[0] - 0.01).abs() < 1e-6 && verdict.pixels == 100, "{verdict:?}");
        assert!(verdict.errors[1].abs() < 1e-9 && verdict.worse() >= verdict.errors[0]);
        // (0.1)² of noise over 100 products is a standard error of 1e-3 of the square, far above the square itself.
        assert!(verdict.uncertainty > 0.01, "{verdict:?}");
    }

    #[test]
    fn judged_pixels_walk_over_all_columns() {
        for pixels in [50, 300, 1000, 3000] {
            let chosen = spread(pixels);
            assert!(chosen.len() <= pixels + 1 && chosen.len() > pixels / 2, "{pixels} {}", chosen.len());
            let columns: std::collections::HashSet<u32> = chosen.iter().map(|p| p % 640).collect();
            assert!(columns.len() >= chosen.len().min(640) - 1, "{pixels}: {} columns", columns.len());
        }
    }
}
