//! What a caller says: the columns, how to invert them, and what is wrong with either.

use super::choose::Strength;

/// How a row is inverted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Dasch's parabolas through three columns.
    ThreePoint,
    /// Rings of constant coefficient, peeled outside in.
    OnionPeeling,
    /// Elements of some degree, regularised by the differences of neighbours.
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

    /// Whether it fits columns, with a strength to be chosen.
    pub fn has_strength(self) -> bool {
        matches!(self, Self::Daun | Self::DaunNonNegative | Self::Basex | Self::Fourier)
    }
}

/// What Daun's method makes the coefficient of, one element a radius.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Elements {
    /// Rings of one value each: degree 0.
    Steps,
    /// Straight lines from value to value: degree 1.
    Linear,
    /// Two parabolas a pixel: degree 2.
    Quadratic,
    /// A cubic spline: degree 3.
    Cubic,
}

impl Elements {
    /// All of them, by degree.
    pub const ALL: [Self; 4] = [Self::Steps, Self::Linear, Self::Quadratic, Self::Cubic];

    /// The elements of a degree, 0 … 3.
    pub fn of_degree(degree: u8) -> Option<Self> {
        Self::ALL.get(usize::from(degree)).copied()
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
    /// Of what elements, for Daun's method.
    pub elements: Elements,
    /// How strongly, for methods that have a strength.
    pub strength: Strength,
    /// The axis in columns, 0 … columns − 1; None finds it.
    pub centre: Option<f64>,
    /// Size of a pixel in m.
    pub pixel_m: f64,
    /// Whether the columns of each row count by 1/σ² in a fit of its own: for methods that fit, with σ given. Strengths are chosen
    /// as without.
    pub weighted: bool,
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

pub(super) fn check(image: &Columns<'_>) -> Result<(), AbelError> {
    let Columns { values, sigmas, rows, columns } = *image;
    let pixels = rows * columns;
    let sigmas = sigmas.map_or(pixels, <[f64]>::len);
    if values.len() != pixels || sigmas != pixels {
        return Err(AbelError::Shape { values: values.len(), sigmas, rows, columns });
    }
    if pixels == 0 { Err(AbelError::Empty) } else { Ok(()) }
}
