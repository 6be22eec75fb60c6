//! The operators of one width and axis: formed once, by method, and applied to any number of images.

use super::answer;
use super::bank::Bank;
use super::choose::Strength;
use super::filtered::{self, Filtered};
use super::grid::Grid;
use super::matrix::Matrix;
use super::operator::Operator;
use super::operators::{self, radius};
use super::request::{AbelError, Columns, Method, Settings, check};
use super::rows::Work;
use super::{Inverted, centre, single};

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

/// The operators of one width and axis, for any number of images.
#[derive(Debug, Clone)]
pub struct Inverter {
    pub(super) settings: Settings,
    pub(super) axis: centre::Axis,
    pub(super) grid: Grid,
    pub(super) kernel: Kernel,
}

/// What is applied to rows.
#[derive(Debug, Clone)]
pub(super) enum Kernel {
    /// One operator for all rows, with its reach: columns nearer to the axis than by so many radii have no part in a radius;
    /// None: all have.
    Fixed(Box<Operator>, Option<usize>),
    /// A strength for each row.
    Bank(Box<Bank>),
}

impl Kernel {
    /// The operator of one choice.
    pub(super) fn operator(&self, choice: usize) -> &Operator {
        match self {
            Self::Fixed(operator, _) => operator,
            Self::Bank(bank) => bank.operator(choice),
        }
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
        let shares = pixel_shares(&grid);
        let plain = |operator: Matrix, reach| {
            Kernel::Fixed(Box::new(Operator::new(operator, Some(reach), &shares)), Some(reach))
        };
        let filtered = |filtered: Filtered| Kernel::Bank(Box::new(Bank::new(filtered, shares.clone())));
        let kernel = match settings.method {
            Method::ThreePoint => Some(plain(operators::three_point(n, phase), 1)),
            Method::OnionPeeling => {
                operators::rings(n, phase).upper_inverse().map(|operator| plain(operator, 0))
            }
            Method::HansenLaw => Some(plain(operators::hansen_law(n, phase), 2)),
            Method::Daun | Method::DaunNonNegative => {
                filtered::daun(n, phase, settings.elements, fixed).map(filtered)
            }
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
        let mut answer = answer::answers(self, &work, memory);
        answer.incomplete = single::answers(self, &work, &answer);
        self.unfold(&work, &answer, out);
        (memory.columns, memory.variances) = (work.columns, work.variances);
        (memory.answers, memory.answer_variances) = (answer.values, answer.variances);
        Ok(())
    }

    /// λ in pixel units or the number of cosines of a choice; NaN for a method without.
    pub(super) fn strength(&self, choice: usize) -> f64 {
        match &self.kernel {
            Kernel::Fixed(..) => f64::NAN,
            Kernel::Bank(bank) => bank.filtered.choices[choice].strength,
        }
    }

    /// Variances of the radii, of complete halves, in variances of a pixel.
    pub(super) fn pixel_shares(&self) -> Vec<f64> {
        pixel_shares(&self.grid)
    }
}

fn pixel_shares(grid: &Grid) -> Vec<f64> {
    let on_axis = usize::from(grid.phase <= 0.0);
    let both = on_axis..grid.right.1.min(grid.left.1);
    (0..grid.n).map(|j| if both.contains(&j) { 0.5 } else { 1.0 }).collect()
}

/// Memory that images of one size can share.
#[derive(Debug, Default)]
pub struct Memory {
    pub(super) columns: Vec<f64>,
    pub(super) variances: Vec<f64>,
    pub(super) answers: Vec<f64>,
    pub(super) answer_variances: Vec<f64>,
    pub(super) coefficients: Vec<f64>,
    pub(super) narrow: Vec<f32>,
    pub(super) narrow_coefficients: Vec<f32>,
}
