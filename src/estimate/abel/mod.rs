//! Inverse Abel transform: from columns along straight sights to the local coefficient of a medium that is round about a
//! vertical axis. Arrays in, arrays out.
//!
//! p(y) = 2 ∫ f(r) r/√(r² − y²) dr is turned round row by row by one of several linear methods, or the one that allows no
//! negative values. The halves of a row are joined by their variances; variances go through exactly, with the squares of
//! the operator. What is missing stays missing only where it must. Knows nothing of files and of what the columns are; see
//! [`super::column`] for columns from emissivities and [`emission`] for temperatures.
//!
//! In reading order: what a caller meets (here), the axis (`centre`), radii and pixels (`grid`), halves (`fold`), the
//! operators (`operators`) and those with a strength (`filtered`, `choose`), bounds (`bounded`), rows that are not
//! complete (`single`), matrices (`matrix`).

mod bounded;
pub mod centre;
mod choose;
pub mod emission;
mod filtered;
pub mod flag;
mod fold;
mod grid;
mod matrix;
mod operators;
mod single;

pub use choose::Strength;

use choose::Said;
use filtered::Filtered;
use fold::{Joined, Pixels};
use grid::Grid;
use matrix::Matrix;
use operators::radius;
use rayon::prelude::*;
use std::borrow::Cow;

/// Rows on each side whose halves tell the noise of a row, where no σ is given.
const NEIGHBOURS: usize = 8;

/// A row whose last column is above this part of its largest …
const EDGE_PART: f64 = 0.02;
/// … and this many standard deviations does not fall to zero at its end.
const EDGE_SIGMAS: f64 = 5.0;

/// How a row is inverted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Dasch's parabolas through three columns.
    ThreePoint,
    /// Rings of constant coefficient, peeled outside in.
    OnionPeeling,
    /// Linear elements, regularised by the differences of neighbours.
    Daun,
    /// The same without negative values.
    DaunNonNegative,
    /// Gaussian-like shells, regularised by their amplitudes.
    Basex,
    /// Cosines fitted by least squares.
    Fourier,
    /// Hansen and Law's recursion: a check.
    HansenLaw,
}

impl Method {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::ThreePoint,
        Self::OnionPeeling,
        Self::Daun,
        Self::DaunNonNegative,
        Self::Basex,
        Self::Fourier,
        Self::HansenLaw,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::ThreePoint => "three_point",
            Self::OnionPeeling => "onion_peeling",
            Self::Daun => "daun",
            Self::DaunNonNegative => "daun_non_negative",
            Self::Basex => "basex",
            Self::Fourier => "fourier",
            Self::HansenLaw => "hansenlaw",
        }
    }

    /// Whether it has a strength to be chosen.
    pub fn has_strength(self) -> bool {
        matches!(self, Self::Daun | Self::DaunNonNegative | Self::Basex | Self::Fourier)
    }
}

/// Columns of an image.
#[derive(Debug, Clone, Copy)]
pub struct Columns<'a> {
    /// `[rows · columns]` in row order; not finite = not known.
    pub values: &'a [f64],
    /// Their standard deviations, `[rows · columns]`; not finite or negative = the column is not known.
    pub sigmas: Option<&'a [f64]>,
    /// Rows of the image, across the axis.
    pub rows: usize,
    /// Pixels of a row.
    pub columns: usize,
}

/// What to do with them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// How.
    pub method: Method,
    /// How strongly, for methods that have a strength.
    pub strength: Strength,
    /// The axis in columns, 0 … columns − 1; None finds it.
    pub centre: Option<f64>,
    /// Size of a pixel in m.
    pub pixel_m: f64,
}

/// Why an image cannot be inverted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AbelError {
    /// the image has no pixels
    #[error("the image has no pixels")]
    Empty,
    /// {values} values and {sigmas} standard deviations for {rows} x {columns} pixels
    #[error("{values} values and {sigmas} standard deviations for {rows} x {columns} pixels")]
    Shape {
        /// Values given.
        values: usize,
        /// Standard deviations given.
        sigmas: usize,
        /// Rows.
        rows: usize,
        /// Columns.
        columns: usize,
    },
    /// the axis must lie in columns 0 … {last}, found {centre}
    #[error("the axis must lie in columns 0 … {last}, found {centre}")]
    Centre {
        /// Where it was said to be.
        centre: f64,
        /// The last column.
        last: usize,
    },
    /// {name} must be {must}, found {found}
    #[error("{name} must be {must}, found {found}")]
    Setting {
        /// Which.
        name: &'static str,
        /// What it should be.
        must: &'static str,
        /// What it is.
        found: f64,
    },
    /// the operator of {columns} columns could not be formed
    #[error("the operator of {columns} columns could not be formed")]
    Operator {
        /// Pixels of a row.
        columns: usize,
    },
}

/// An inverted image.
#[derive(Debug, Clone, PartialEq)]
pub struct Inverted {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// The local coefficient at every pixel, 1/m, `[rows · columns]`; NaN where it is not known.
    pub alpha_per_m: Vec<f64>,
    /// Its standard deviation, 1/m; NaN where it is not known. Without given σ from what the halves of the rows around differ,
    /// or where there is one half only from the ripple of neighbouring columns. Of the noise alone: what a strength or
    /// pixels smooth away is not in it.
    pub sigma_alpha: Vec<f64>,
    /// Bits of [`flag`].
    pub flags: Vec<u32>,
    /// The axis.
    pub axis: centre::Axis,
    /// Strength of each row: λ in pixel units or the number of cosines; NaN where the method has none.
    pub strength: Vec<f64>,
    /// Rows for which no strength fitted the given σ, so that cross-validation chose.
    pub discrepancy_failed: usize,
}

impl Inverted {
    /// An image of no pixels, to be filled by [`Inverter::invert_into`].
    pub fn empty() -> Self {
        Self {
            rows: 0,
            columns: 0,
            alpha_per_m: Vec::new(),
            sigma_alpha: Vec::new(),
            flags: Vec::new(),
            axis: centre::Axis { column: f64::NAN, sigma: f64::NAN, found: false },
            strength: Vec::new(),
            discrepancy_failed: 0,
        }
    }

    /// How many pixels carry each flag, in the order of [`flag::LEGEND`].
    pub fn flag_counts(&self) -> Vec<(&'static str, usize)> {
        let count = |bit: u32| self.flags.iter().filter(|&&flags| flags & bit != 0).count();
        flag::LEGEND.iter().map(|&(bit, name, _)| (name, count(bit))).collect()
    }
}

/// Inverts an image: finds the axis if it is not given, forms the operator, applies it.
///
/// # Errors
///
/// [`AbelError`] for shapes, axes and settings that make no sense.
pub fn invert(image: &Columns<'_>, settings: &Settings) -> Result<Inverted, AbelError> {
    check(image)?;
    let axis = match settings.centre {
        Some(column) => centre::Axis { column, sigma: 0.0, found: false },
        None => centre::find(image.values, image.rows, image.columns),
    };
    Inverter::new(image.columns, axis, settings)?.invert(image)
}

fn check(image: &Columns<'_>) -> Result<(), AbelError> {
    let Columns { values, sigmas, rows, columns } = *image;
    let pixels = rows * columns;
    let sigmas = sigmas.map_or(pixels, <[f64]>::len);
    if values.len() != pixels || sigmas != pixels {
        return Err(AbelError::Shape { values: values.len(), sigmas, rows, columns });
    }
    if pixels == 0 { Err(AbelError::Empty) } else { Ok(()) }
}

/// The operators of one width and axis, for any number of images.
#[derive(Debug, Clone)]
pub struct Inverter {
    settings: Settings,
    axis: centre::Axis,
    grid: Grid,
    kernel: Kernel,
}

#[derive(Debug, Clone)]
enum Kernel {
    Fixed(Fixed),
    Filtered(Filtered),
}

/// One operator for all rows.
#[derive(Debug, Clone)]
struct Fixed {
    /// Row i belongs to radius i.
    operator: Matrix,
    /// Its transpose, and that of its squares.
    across: Matrix,
    squares: Matrix,
    /// Columns nearer to the axis than by this many radii have no part in a radius; None: all have.
    reach: Option<usize>,
}

impl Fixed {
    fn new(operator: Matrix, reach: Option<usize>) -> Self {
        let across = operator.transposed();
        Self { squares: across.squared(), across, operator, reach }
    }
}

impl Inverter {
    /// Forms the operators for rows of `columns` pixels.
    ///
    /// # Errors
    ///
    /// [`AbelError`] for axes and settings that make no sense.
    pub fn new(columns: usize, axis: centre::Axis, settings: &Settings) -> Result<Self, AbelError> {
        let last = columns.checked_sub(1).ok_or(AbelError::Empty)?;
        if !(0.0..=radius(last, 0.0)).contains(&axis.column) {
            return Err(AbelError::Centre { centre: axis.column, last });
        }
        if !(settings.pixel_m > 0.0 && settings.pixel_m.is_finite()) {
            let found = settings.pixel_m;
            return Err(AbelError::Setting { name: "the size of a pixel", must: "positive", found });
        }
        let fixed = match settings.strength {
            Strength::Fixed(strength) if !(strength >= 0.0 && strength.is_finite()) => {
                let must = "0 or more";
                return Err(AbelError::Setting { name: "the strength", must, found: strength });
            }
            Strength::Fixed(strength) => Some(strength),
            _ => None,
        };
        let grid = Grid::new(columns, axis.column);
        let (n, phase) = (grid.n, grid.phase);
        let plain = |operator: Matrix, reach| Kernel::Fixed(Fixed::new(operator, Some(reach)));
        let filtered = |filtered: Filtered| match fixed {
            Some(_) if settings.method != Method::DaunNonNegative => {
                Kernel::Fixed(Fixed::new(filtered.operator(0), None))
            }
            _ => Kernel::Filtered(filtered),
        };
        let kernel = match settings.method {
            Method::ThreePoint => Some(plain(operators::three_point(n, phase), 1)),
            Method::OnionPeeling => {
                operators::rings(n, phase).upper_inverse().map(|operator| plain(operator, 0))
            }
            Method::HansenLaw => Some(plain(operators::hansen_law(n, phase), 2)),
            Method::Daun | Method::DaunNonNegative => filtered::daun(n, phase, fixed).map(filtered),
            Method::Basex => filtered::basex(n, phase, fixed).map(filtered),
            Method::Fourier => Some(filtered(filtered::fourier(n, phase, fixed))),
        };
        let kernel = kernel.ok_or(AbelError::Operator { columns })?;
        Ok(Self { settings: *settings, axis, grid, kernel })
    }

    /// Inverts an image of this width.
    ///
    /// # Errors
    ///
    /// [`AbelError::Shape`] for another width, [`AbelError::Empty`] for none.
    pub fn invert(&self, image: &Columns<'_>) -> Result<Inverted, AbelError> {
        let mut out = Inverted::empty();
        self.invert_into(image, &mut out, &mut Memory::default())?;
        Ok(out)
    }

    /// As [`Self::invert`], into memory that is used again: half of the time of an image goes into fresh memory.
    ///
    /// # Errors
    ///
    /// As [`Self::invert`]; `out` is then unchanged.
    pub fn invert_into(
        &self,
        image: &Columns<'_>,
        out: &mut Inverted,
        memory: &mut Memory,
    ) -> Result<(), AbelError> {
        check(image)?;
        let Columns { values, sigmas, rows, columns } = *image;
        if columns != self.grid.columns {
            let (values, sigmas) = (values.len(), sigmas.map_or(0, <[f64]>::len));
            return Err(AbelError::Shape { values, sigmas, rows, columns: self.grid.columns });
        }
        let work = Work::prepare(&self.grid, image, memory);
        let mut answer = Answer::empty(&work, self.grid.n, memory);
        match &self.kernel {
            Kernel::Fixed(fixed) => self.by_operator(&work, fixed, &mut answer),
            Kernel::Filtered(filtered) => self.by_filter(&work, filtered, &mut answer),
        }
        answer.incomplete = single::answers(self, &work, &answer);
        self.unfold(image, &work, &answer, out);
        let (columns, variances) = (work.columns, work.variances);
        *memory = Memory { columns, variances, answers: answer.values, answer_variances: answer.variances };
        Ok(())
    }

    fn by_operator(&self, work: &Work<'_>, fixed: &Fixed, answer: &mut Answer) {
        let n = self.grid.n;
        matrix::multiply(&work.columns, n, &fixed.across, fixed.reach, &mut answer.values);
        match work.given {
            true => matrix::multiply(&work.variances, n, &fixed.squares, fixed.reach, &mut answer.variances),
            false => {
                let unit = self.unit_variances(&fixed.operator);
                for (row, variances) in answer.variances.chunks_mut(n).enumerate() {
                    variances.iter_mut().zip(&unit).for_each(|(v, unit)| *v = work.noise[row] * unit);
                }
            }
        }
        if let Strength::Fixed(strength) = self.settings.strength
            && self.settings.method.has_strength()
        {
            answer.strength.fill(strength);
        }
    }

    /// Variances at the radii for pixels of variance 1, where both halves are complete.
    fn unit_variances(&self, operator: &Matrix) -> Vec<f64> {
        let share = |(j, d): (usize, &f64)| d * d * self.pixel_share(j);
        (0..self.grid.n).map(|i| operator.row(i).iter().enumerate().map(share).sum()).collect()
    }

    /// Variance of radius `j`, of complete halves, in variances of a pixel.
    fn pixel_share(&self, j: usize) -> f64 {
        let grid = &self.grid;
        let on_axis = usize::from(grid.phase <= 0.0);
        if (on_axis..grid.right.1.min(grid.left.1)).contains(&j) { 0.5 } else { 1.0 }
    }

    fn pixel_shares(&self) -> f64 {
        (0..self.grid.n).map(|j| self.pixel_share(j)).sum()
    }

    fn by_filter(&self, work: &Work<'_>, filtered: &Filtered, answer: &mut Answer) {
        let n = self.grid.n;
        let members = filtered.analysis.columns;
        let mut coefficients = vec![0.0; work.rows * members];
        matrix::multiply(&work.columns, n, &filtered.analysis, None, &mut coefficients);
        let squares: Vec<f64> = work.columns.chunks(n).map(|row| row.iter().map(|p| p * p).sum()).collect();
        let measured: Vec<f64> = work.noise.iter().map(|noise| noise * self.pixel_shares()).collect();
        let given: Vec<f64> = work.variances.chunks(n).map(|row| row.iter().sum()).collect();
        let discrepancy = match self.settings.strength {
            Strength::Automatic | Strength::Discrepancy => work.given,
            Strength::CrossValidation | Strength::Fixed(_) => false,
        };
        let said = Said {
            coefficients: &coefficients,
            squares: &squares,
            measured: &measured,
            given: discrepancy.then_some(&given),
        };
        let (choices, failed) = choose::choices(filtered, &said, n);
        for (coefficients, &choice) in coefficients.chunks_mut(members).zip(&choices) {
            let filter = &filtered.choices[choice].filter;
            coefficients.iter_mut().zip(filter).for_each(|(c, filter)| *c *= filter);
        }
        matrix::multiply(&coefficients, members, &filtered.synthesis, None, &mut answer.values);
        for (values, &choice) in answer.values.chunks_mut(n).zip(&choices) {
            let correction = &filtered.choices[choice].correction;
            values.iter_mut().zip(correction).for_each(|(value, factor)| *value *= factor);
        }
        // Variances, choice by choice.
        let mut used = choices.clone();
        used.sort_unstable();
        used.dedup();
        for choice in used {
            let operator = filtered.operator(choice);
            if work.given {
                let squares = operator.transposed().squared();
                let at: Vec<usize> = (0..work.rows).filter(|&row| choices[row] == choice).collect();
                let some: Vec<f64> =
                    at.iter().flat_map(|row| &work.variances[row * n..(row + 1) * n]).copied().collect();
                let mut out = vec![0.0; some.len()];
                matrix::multiply(&some, n, &squares, None, &mut out);
                for (row, out) in at.iter().zip(out.chunks(n)) {
                    answer.variances[row * n..(row + 1) * n].copy_from_slice(out);
                }
            } else {
                let unit = self.unit_variances(&operator);
                for row in (0..work.rows).filter(|&row| choices[row] == choice) {
                    let variances = &mut answer.variances[row * n..(row + 1) * n];
                    variances.iter_mut().zip(&unit).for_each(|(v, unit)| *v = work.noise[row] * unit);
                }
            }
        }
        for (strength, &choice) in answer.strength.iter_mut().zip(&choices) {
            *strength = filtered.choices[choice].strength;
        }
        answer.choices = choices;
        answer.discrepancy_failed = failed;
    }

    /// From radii to pixels.
    fn unfold(&self, image: &Columns<'_>, work: &Work<'_>, answer: &Answer, out: &mut Inverted) {
        let grid = &self.grid;
        let (rows, columns, n) = (image.rows, image.columns, grid.n);
        let scale = work.scale / self.settings.pixel_m;
        (out.rows, out.columns, out.axis) = (rows, columns, self.axis);
        resize(&mut out.alpha_per_m, rows * columns);
        resize(&mut out.sigma_alpha, rows * columns);
        out.flags.resize(rows * columns, 0);
        out.strength.clone_from(&answer.strength);
        out.discrepancy_failed = answer.discrepancy_failed;
        let ((right, to_right), (left, to_left)) = (grid.right, grid.left);
        let both = to_right.min(to_left);
        let one_side = |column: usize| {
            // Rounding is for axes between the radii, whose rows all go alone.
            let i = grid.radii(column)[0].0;
            if i < both { 0 } else { flag::ONE_SIDE }
        };
        let one_side: Vec<u32> = (0..columns).map(one_side).collect();
        out.alpha_per_m
            .par_chunks_mut(columns)
            .zip(out.sigma_alpha.par_chunks_mut(columns))
            .zip(out.flags.par_chunks_mut(columns))
            .enumerate()
            .for_each(|(row, ((alpha, sigma), flags))| {
                let edge = if work.truncated[row] { flag::TRUNCATED } else { 0 };
                if let Some(found) = &answer.incomplete[row] {
                    for column in 0..columns {
                        alpha[column] = found.values[column] * scale;
                        sigma[column] = found.variances[column].sqrt() * scale;
                        flags[column] = found.flags[column] | edge;
                    }
                    return;
                }
                let at = row * n..(row + 1) * n;
                for (values, to, unit) in
                    [(&answer.values[at.clone()], alpha, false), (&answer.variances[at], sigma, true)]
                {
                    let half = to[right..right + to_right].iter_mut().zip(values);
                    if unit {
                        half.for_each(|(to, v)| *to = v.sqrt() * scale);
                    } else {
                        half.for_each(|(to, v)| *to = v * scale);
                    }
                    // The other half is its mirror image, as far as both reach.
                    let (to_the_left, rest) = to.split_at_mut(right);
                    let own = usize::from(left == right);
                    let mirrored = to_the_left.iter_mut().rev().zip(&rest[own..]);
                    mirrored.take(both - own).for_each(|(to, v)| *to = *v);
                    for i in both..to_left {
                        to[left - i] = if unit { values[i].sqrt() * scale } else { values[i] * scale };
                    }
                }
                flags.iter_mut().zip(&one_side).for_each(|(flags, one_side)| *flags = one_side | edge);
            });
    }
}

/// Makes room; what was there is overwritten.
fn resize(values: &mut Vec<f64>, length: usize) {
    if values.len() != length {
        *values = vec![0.0; length];
    }
}

/// Memory that images of one size can share.
#[derive(Debug, Default)]
pub struct Memory {
    columns: Vec<f64>,
    variances: Vec<f64>,
    answers: Vec<f64>,
    answer_variances: Vec<f64>,
}

/// Variance of a column by the third differences of neighbours: next to none for a smooth row. Their median, so that edges
/// do not count. NaN for fewer than eight columns.
fn ripple(columns: &[f64]) -> f64 {
    if columns.len() < 8 {
        return f64::NAN;
    }
    let third = |w: &[f64]| (w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0]).abs();
    let mut sizes: Vec<f64> = columns.windows(4).map(third).collect();
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    // A normal variable's median magnitude is 0.6745 σ; 1 + 9 + 9 + 1 variances.
    (*median / 0.6745).powi(2) / 20.0
}

/// Bits of the largest magnitude: as integers they are in order, infinity and NaN above all numbers, and vectors can
/// compare them.
fn largest_bits(values: &[f64]) -> u64 {
    values.iter().fold(0, |most, v| most.max(v.to_bits() & (u64::MAX >> 1)))
}

fn all_finite(values: &[f64]) -> bool {
    largest_bits(values) < f64::INFINITY.to_bits()
}

/// The largest magnitude of those that are finite.
fn largest_finite(values: &[f64]) -> f64 {
    let bits = largest_bits(values);
    if bits < f64::INFINITY.to_bits() {
        return f64::from_bits(bits);
    }
    values.iter().filter(|v| v.is_finite()).fold(0.0, |most, v| most.max(v.abs()))
}

/// Rows joined to columns at the radii, in units that keep squares finite.
struct Work<'a> {
    rows: usize,
    /// Joined columns, `[rows · n]`; of incomplete rows a guess, for the strength only.
    columns: Vec<f64>,
    /// Their variances, if σ is given: else zero.
    variances: Vec<f64>,
    given: bool,
    /// Variance of a pixel by its own row and some rows around; NaN where nothing tells it.
    noise: Vec<f64>,
    /// Rows that go alone.
    incomplete: Vec<Option<Joined>>,
    truncated: Vec<bool>,
    /// The image in units of `scale`, and the variances of its pixels.
    pixels: Cow<'a, [f64]>,
    pixel_variances: Vec<f64>,
    scale: f64,
}

/// Answers at the radii.
struct Answer {
    values: Vec<f64>,
    variances: Vec<f64>,
    strength: Vec<f64>,
    choices: Vec<usize>,
    discrepancy_failed: usize,
    /// Answers at the pixels, of rows that went alone.
    incomplete: Vec<Option<single::Found>>,
}

impl Answer {
    fn empty(work: &Work<'_>, n: usize, memory: &mut Memory) -> Self {
        let mut values = std::mem::take(&mut memory.answers);
        let mut variances = std::mem::take(&mut memory.answer_variances);
        resize(&mut values, work.rows * n);
        resize(&mut variances, work.rows * n);
        Self {
            values,
            variances,
            strength: vec![f64::NAN; work.rows],
            choices: vec![0; work.rows],
            discrepancy_failed: 0,
            incomplete: Vec::new(),
        }
    }
}

impl<'a> Work<'a> {
    fn prepare(grid: &Grid, image: &Columns<'a>, memory: &mut Memory) -> Self {
        let Columns { values, sigmas, rows, columns } = *image;
        let n = grid.n;
        let largest = values.par_chunks(columns).map(largest_finite).reduce(|| 0.0, f64::max);
        // Squares must fit. A power of two: nothing is rounded.
        let fits = largest <= 0.0 || (1e-100..1e100).contains(&largest);
        let scale = if fits { 1.0 } else { libm::ldexp(1.0, libm::ilogb(largest).clamp(-1000, 1000)) };
        let scaled = || values.par_iter().map(|value| value / scale).collect();
        let pixels = if fits { Cow::Borrowed(values) } else { Cow::Owned(scaled()) };
        let pixel_variances: Vec<f64> = sigmas
            .map(|sigmas| {
                let each = sigmas.par_iter();
                each.map(|s| if *s >= 0.0 { (s / scale) * (s / scale) } else { f64::NAN }).collect()
            })
            .unwrap_or_default();
        let mut joined = std::mem::take(&mut memory.columns);
        let mut variances = std::mem::take(&mut memory.variances);
        resize(&mut joined, rows * n);
        resize(&mut variances, if sigmas.is_some() { rows * n } else { 0 });
        let mut out = Self {
            rows,
            columns: joined,
            variances,
            given: sigmas.is_some(),
            noise: vec![f64::NAN; rows],
            incomplete: vec![None; rows],
            truncated: vec![false; rows],
            pixels,
            pixel_variances,
            scale,
        };
        let mut none: Vec<[f64; 0]> = vec![[]; rows];
        let mut parts: Vec<&mut [f64]> = if out.given {
            out.variances.chunks_mut(n).collect()
        } else {
            none.iter_mut().map(|none| &mut none[..]).collect()
        };
        let (pixels, pixel_variances) = (&out.pixels, &out.pixel_variances);
        let row_of = |row: usize| {
            let range = row * columns..(row + 1) * columns;
            let variances = sigmas.map(|_| &pixel_variances[range.clone()]);
            Pixels { values: &pixels[range], variances }
        };
        let squares: Vec<(f64, f64)> = out
            .columns
            .par_chunks_mut(n)
            .zip(parts.par_iter_mut())
            .zip(out.incomplete.par_iter_mut())
            .enumerate()
            .map(|(row, ((joined, variances), incomplete))| {
                let pixels = row_of(row);
                let complete = all_finite(pixels.values) && pixels.variances.is_none_or(all_finite);
                if grid.plain && complete {
                    return fold::join_complete(grid, &pixels, joined, variances);
                }
                let found = fold::join(grid, &pixels);
                let squares = found.squares;
                found.spread(&pixels, joined, variances);
                *incomplete = Some(found);
                squares
            })
            .collect();
        drop(parts);
        for row in 0..rows {
            let window = row.saturating_sub(NEIGHBOURS)..(row + NEIGHBOURS + 1).min(rows);
            let (square, count) =
                squares[window].iter().fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
            // Or one side only.
            let alone = || ripple(&out.columns[row * n..(row + 1) * n]);
            out.noise[row] = if count > 0.0 { square / count } else { alone() };
        }
        for row in 0..rows {
            out.truncated[row] = out.ends_above_zero(row, n);
        }
        out
    }

    fn ends_above_zero(&self, row: usize, n: usize) -> bool {
        let columns = &self.columns[row * n..(row + 1) * n];
        let last = self.incomplete[row].as_ref().map_or(n, |joined| joined.to).saturating_sub(1);
        let most = largest_finite(columns);
        let variance = if self.given { self.variances[row * n + last] } else { self.noise[row] };
        let sigma = if variance.is_finite() { variance.sqrt() } else { 0.0 };
        columns[last].abs() > (EDGE_PART * most).max(EDGE_SIGMAS * sigma)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PHASES: [(usize, f64); 4] = [(41, 20.0), (40, 19.5), (43, 18.0), (41, 19.83)];

    fn settings(method: Method, centre: f64) -> Settings {
        let strength = if method == Method::Fourier { 8.0 } else { 0.5 };
        Settings { method, strength: Strength::Fixed(strength), centre: Some(centre), pixel_m: 1e-3 }
    }

    /// Columns of a Gaussian of `width` pixels and its coefficient, in 1/m for pixels of 1 mm.
    fn gaussian(rows: usize, columns: usize, centre: f64, width: f64) -> (Vec<f64>, Vec<f64>) {
        let f = |c: usize| (-((radius(c, 0.0) - centre) / width).powi(2)).exp();
        let each = || (0..rows).flat_map(|_| 0..columns);
        let column = each().map(|c| width * std::f64::consts::PI.sqrt() * f(c) * 1e-3).collect();
        (column, each().map(f).collect())
    }

    fn pseudo_noise(i: usize) -> f64 {
        ((i * 7919 + 13) % 1009) as f64 / 504.0 - 1.0
    }

    #[test]
    fn every_method_finds_a_gaussian_about_any_axis() {
        for (columns, centre) in PHASES {
            let (column, truth) = gaussian(3, columns, centre, 6.0);
            for method in Method::ALL {
                // By the second derivative on the axis, 2/6²: rings err by two thirds of a quarter of it, hats and
                // parabolas less; the exponentials of Hansen and Law, cubic interpolation and strengths a little.
                let wanted = Settings { strength: Strength::Automatic, ..settings(method, centre) };
                let image = Columns { values: &column, sigmas: None, rows: 3, columns };
                let found = invert(&image, &wanted).unwrap();
                for (got, want) in found.alpha_per_m.iter().zip(&truth) {
                    assert!((got - want).abs() < 0.04, "{method:?} {columns} {centre}: {got} {want}");
                }
                let rms = found.alpha_per_m.iter().zip(&truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
                let rms = (rms / radius(truth.len(), 0.0)).sqrt();
                assert!(rms < 0.012, "{method:?} {columns} {centre}: {rms}");
            }
        }
    }

    /// All but the bounded one are linear: each pixel's share of each answer, measured by moving it, squared and summed
    /// is the variance that was told. On whole rows, rows with holes, and about axes between the radii.
    #[test]
    fn variances_are_those_of_the_operators_rows() {
        for (columns, centre) in PHASES {
            for method in Method::ALL.into_iter().filter(|m| *m != Method::DaunNonNegative) {
                for holes in [false, true] {
                    let (mut values, _) = gaussian(1, columns, centre, 7.0);
                    if holes {
                        values[4] = f64::NAN;
                        (16..24).for_each(|c| values[c] = f64::NAN);
                    }
                    let sigmas: Vec<f64> = (0..columns).map(|c| 1e-5 * (2.0 + pseudo_noise(c))).collect();
                    let run = |values: &[f64]| {
                        let image = Columns { values, sigmas: Some(&sigmas), rows: 1, columns };
                        invert(&image, &settings(method, centre)).unwrap()
                    };
                    let first = run(&values);
                    let mut sums = vec![0.0; columns];
                    for c in (0..columns).filter(|&c| values[c].is_finite()) {
                        let mut moved = values.clone();
                        moved[c] += sigmas[c];
                        let then = run(&moved);
                        for (i, sum) in sums.iter_mut().enumerate() {
                            *sum += (then.alpha_per_m[i] - first.alpha_per_m[i]).powi(2);
                        }
                    }
                    for (i, sum) in sums.iter().enumerate() {
                        let (told, measured) = (first.sigma_alpha[i], sum.sqrt());
                        if first.alpha_per_m[i].is_nan() {
                            assert!(told.is_nan() && first.flags[i] & flag::HIDDEN != 0);
                        } else {
                            let close = (told - measured).abs() < 1e-6 * measured + 1e-12;
                            assert!(close, "{method:?} {centre} {holes} {i}: {told} {measured}");
                        }
                    }
                }
            }
        }
    }

    /// A hole about the axis leaves what is outside of it as it is; a hole on one side nothing but a flag.
    #[test]
    fn holes_hide_what_they_must_and_no_more() {
        let (columns, centre) = (61, 30.0);
        let (whole, truth) = gaussian(2, columns, centre, 9.0);
        for method in Method::ALL {
            let mut values = whole.clone();
            (25..36).for_each(|c| values[c] = f64::NAN);
            values[columns + 50] = f64::NAN;
            let wanted = Settings { strength: Strength::Automatic, ..settings(method, centre) };
            let image = Columns { values: &values, sigmas: None, rows: 2, columns };
            let found = invert(&image, &wanted).unwrap();
            for c in 0..columns {
                let inside = (25..36).contains(&c);
                assert_eq!(found.alpha_per_m[c].is_nan(), inside, "{method:?} {c}");
                assert_eq!(found.flags[c] & flag::HIDDEN != 0, inside);
                assert_eq!(found.flags[c] & flag::NO_INPUT != 0, inside);
                if !inside {
                    // Next to the hole the strength has only one neighbour to hold on to.
                    let error = (found.alpha_per_m[c] - truth[c]).abs();
                    assert!(error < 0.05, "{method:?} {c} {error}");
                }
                let other = columns + c;
                assert!((found.alpha_per_m[other] - truth[other]).abs() < 0.03, "{method:?} {c}");
                let beside = c == 50 || c == 10;
                assert_eq!(found.flags[other] & flag::ONE_SIDE != 0, beside, "{method:?} {c}");
            }
            assert_ne!(found.flags[columns + 50] & flag::NO_INPUT, 0);
        }
    }

    #[test]
    fn nasty_images_give_numbers_or_flags() {
        for method in Method::ALL {
            for columns in 1..6 {
                for values in
                    [vec![0.0; columns], vec![1.0; columns], vec![f64::NAN; columns], vec![-3.0; columns]]
                {
                    let wanted =
                        Settings { centre: None, strength: Strength::Automatic, ..settings(method, 0.0) };
                    let image = Columns { values: &values, sigmas: None, rows: 1, columns };
                    let found = invert(&image, &wanted).unwrap();
                    for (i, value) in found.alpha_per_m.iter().enumerate() {
                        assert_eq!(
                            value.is_nan(),
                            found.flags[i] & flag::HIDDEN != 0,
                            "{method:?} {columns} {values:?}"
                        );
                        assert!(value.is_nan() == values[0].is_nan());
                        assert!(values[0] != 0.0 || *value == 0.0);
                    }
                }
            }
            // Magnitudes whose squares are beyond f64, beside rows of nothing.
            let (mut values, truth) = gaussian(3, 41, 20.0, 6.0);
            values[..41].iter_mut().for_each(|v| *v *= 1e250);
            values[82..].fill(0.0);
            let image = Columns { values: &values, sigmas: None, rows: 3, columns: 41 };
            let found = invert(&image, &settings(method, 20.0)).unwrap();
            assert!((found.alpha_per_m[14] / 1e250 - truth[14]).abs() < 0.04, "{method:?}");
            assert!(found.alpha_per_m[82..].iter().all(|v| *v == 0.0));
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        let image = Columns { values: &[1.0; 6], sigmas: None, rows: 2, columns: 3 };
        let good = settings(Method::Fourier, 1.0);
        assert!(invert(&image, &good).is_ok());
        let wrong = [
            Settings { centre: Some(3.0), ..good },
            Settings { centre: Some(f64::NAN), ..good },
            Settings { pixel_m: 0.0, ..good },
            Settings { strength: Strength::Fixed(-1.0), ..good },
            Settings { strength: Strength::Fixed(f64::NAN), ..good },
        ];
        assert!(wrong.iter().all(|settings| invert(&image, settings).is_err()));
        let shapes = [
            Columns { values: &[1.0; 5], ..image },
            Columns { sigmas: Some(&[1.0; 5]), ..image },
            Columns { rows: 0, values: &[], ..image },
        ];
        assert!(shapes.iter().all(|image| invert(image, &good).is_err()));
    }

    /// A column below zero has no answer above: the bounded method gives zero there and says so, and what is positive is not
    /// worse than before.
    #[test]
    fn bounded_answers_are_not_negative() {
        let (columns, centre) = (61, 30.0);
        let (mut values, truth) = gaussian(20, columns, centre, 6.0);
        values.iter_mut().enumerate().for_each(|(i, v)| *v += 2e-4 * pseudo_noise(i));
        let image = Columns { values: &values, sigmas: None, rows: 20, columns };
        let run = |method| {
            invert(&image, &Settings { strength: Strength::Automatic, ..settings(method, centre) }).unwrap()
        };
        let (free, bound) = (run(Method::Daun), run(Method::DaunNonNegative));
        assert!(free.alpha_per_m.iter().any(|a| *a < 0.0));
        assert!(bound.alpha_per_m.iter().all(|a| *a >= 0.0));
        let at_bound = bound.flags.iter().filter(|f| **f & flag::AT_BOUND != 0).count();
        assert!(at_bound > 100 && bound.flags.iter().all(|f| f & flag::NOT_SETTLED == 0));
        let error = |found: &Inverted| {
            found.alpha_per_m.iter().zip(&truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>()
        };
        assert!(error(&bound) < error(&free));
    }

    /// A row that does not end at zero is flagged, and a strength too weak for the noise is not taken because σ was told
    /// too small.
    #[test]
    fn ends_and_noise_are_judged() {
        let (columns, centre) = (81, 40.0);
        let (mut values, _) = gaussian(30, columns, centre, 12.0);
        let noise = 1e-4;
        values.iter_mut().enumerate().for_each(|(i, v)| *v += noise * pseudo_noise(i * 31 + i / 7));
        let ask = |values: &[f64], sigma: Option<f64>| {
            let sigmas = sigma.map(|sigma| vec![sigma; values.len()]);
            let image = Columns { values, sigmas: sigmas.as_deref(), rows: 30, columns };
            let wanted = Settings { strength: Strength::Automatic, ..settings(Method::Fourier, centre) };
            invert(&image, &wanted).unwrap()
        };
        // The noise above is uniform: σ is 1/√3 of its amplitude.
        let by_data = ask(&values, None);
        let by_sigma = ask(&values, Some(noise / 3.0_f64.sqrt()));
        let too_small = ask(&values, Some(0.1 * noise));
        assert!(too_small.discrepancy_failed == 30 && too_small.strength == by_data.strength);
        assert!(by_sigma.strength.iter().zip(&by_data.strength).all(|(a, b)| a <= b));
        assert!(by_data.flags.iter().all(|f| f & flag::TRUNCATED == 0));
        let raised: Vec<f64> = values.iter().map(|v| v + 0.002).collect();
        assert!(ask(&raised, None).flags.iter().all(|f| f & flag::TRUNCATED != 0));
    }

    /// The same bits for any number of threads.
    #[test]
    fn threads_change_nothing() {
        let (values, _) = gaussian(70, 41, 20.0, 6.0);
        let image = Columns { values: &values, sigmas: None, rows: 70, columns: 41 };
        for method in Method::ALL {
            let run = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let found = pool.install(|| invert(&image, &settings(method, 20.0))).unwrap();
                found.alpha_per_m.iter().chain(&found.sigma_alpha).map(|v| v.to_bits()).collect::<Vec<_>>()
            };
            assert_eq!(run(1), run(3), "{method:?}");
        }
    }
}
