//! `ditd abel`: inverse Abel transform of columns about a vertical axis.

use super::{CommandError, CommandResult, print};
use crate::estimate::abel::{self, Columns, Elements, Inverted, Method, Settings, Strength, emission, flag};
use crate::estimate::column::Growth;
use crate::files::npy::{self, Array, Values};
use crate::files::npz::{self, Packing};
use crate::files::write_atomic;
use crate::tables::TextTable;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Arguments of `ditd abel`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Columns (NPY, [rows, columns], any number type), by default −ln(1 − ε); NaN = not known
    #[arg(value_name = "IN.npy")]
    input: PathBuf,
    /// How to invert
    #[arg(long, value_enum)]
    method: MethodName,
    #[command(flatten)]
    pub(super) how: How,
    /// Standard deviations of the input, of its shape
    #[arg(long, value_name = "S.npy")]
    sigma: Option<PathBuf>,
    /// The input is the emissivity, not the column
    #[arg(long)]
    emissivity: bool,
    /// Light that the medium itself sends, of the input's shape, in any unit: gives its source too
    #[arg(long, value_name = "E.npy")]
    emission: Option<PathBuf>,
    /// Standard deviations of --emission
    #[arg(long, value_name = "S.npy", requires = "emission")]
    emission_sigma: Option<PathBuf>,
    /// Where to write; without it only the summary is printed
    #[arg(long, value_name = "OUT.npz")]
    out: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// What `ditd abel` and `ditd fit --abel` share.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct How {
    /// Size of a pixel in the plane of the axis, m; 1 gives coefficients per pixel
    #[arg(long, value_name = "P", default_value_t = 1.0)]
    pub(super) pixel_m: f64,
    /// The axis in columns from the middle of the first one; found if not given
    #[arg(long, value_name = "C")]
    pub(super) centre: Option<f64>,
    /// How strongly to regularise (daun, basex: λ in pixels; fourier: cosines): auto, gcv, discrepancy or a number
    #[arg(long, value_name = "HOW", default_value = "auto", value_parser = strength)]
    pub(super) strength: Strength,
    /// Daun's method without negative values
    #[arg(long)]
    pub(super) non_negative: bool,
    /// Daun's method with elements of this degree: 0 steps, 1 straight lines (if not given), 2 parabolas, 3 a cubic spline
    #[arg(long, value_name = "DEGREE", value_parser = clap::value_parser!(u8).range(0..=3))]
    pub(super) degree: Option<u8>,
    /// Columns of a row count by 1/σ² in a fit of its own (daun, basex, fourier; needs σ): better where σ varies within rows, some
    /// ten milliseconds a row
    #[arg(long)]
    pub(super) weighted: bool,
    /// Curve of growth of the absorber in the band: CSV with columns weight (response times plate light) and k (absorption)
    #[arg(long, value_name = "FILE.csv")]
    pub(super) growth: Option<PathBuf>,
}

/// Names of the methods on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
#[value(rename_all = "snake_case")]
pub(super) enum MethodName {
    /// Parabolas through three columns (Dasch)
    ThreePoint,
    /// Rings, peeled outside in
    OnionPeeling,
    /// Elements of --degree, regularised by the differences of neighbours
    Daun,
    /// Gaussian-like shells, regularised by their amplitudes
    Basex,
    /// Cosines fitted by least squares (Pretzler): for smooth profiles with noise
    Fourier,
    /// Hansen and Law's recursion: a check
    #[value(name = "hansenlaw", alias = "hansen_law")]
    HansenLaw,
}

/// Reads a strength.
pub(super) fn strength(text: &str) -> Result<Strength, String> {
    match text {
        "auto" => Ok(Strength::Automatic),
        "gcv" => Ok(Strength::CrossValidation),
        "discrepancy" => Ok(Strength::Discrepancy),
        number => match number.parse::<f64>() {
            Ok(value) if value >= 0.0 && value.is_finite() => Ok(Strength::Fixed(value)),
            _ => Err("auto, gcv, discrepancy, or a number that is not negative".into()),
        },
    }
}

impl How {
    /// The settings of a method.
    ///
    /// # Errors
    ///
    /// Status 2 when they contradict each other.
    pub(super) fn settings(&self, method: MethodName) -> Result<Settings, CommandError> {
        let method = match (method, self.non_negative) {
            (MethodName::Daun, true) => Method::DaunNonNegative,
            (_, true) => return Err(CommandError::usage("abel: --non-negative goes with --method daun.")),
            (MethodName::ThreePoint, _) => Method::ThreePoint,
            (MethodName::OnionPeeling, _) => Method::OnionPeeling,
            (MethodName::Daun, _) => Method::Daun,
            (MethodName::Basex, _) => Method::Basex,
            (MethodName::Fourier, _) => Method::Fourier,
            (MethodName::HansenLaw, _) => Method::HansenLaw,
        };
        let elements = match (self.degree, method) {
            (None, _) => Elements::Linear,
            (Some(degree), Method::Daun | Method::DaunNonNegative) => Elements::of_degree(degree)
                .ok_or_else(|| CommandError::usage("abel: --degree is 0, 1, 2 or 3."))?,
            (Some(_), _) => return Err(CommandError::usage("abel: --degree goes with --method daun.")),
        };
        let Self { strength, centre, pixel_m, weighted, .. } = *self;
        if weighted && !method.has_strength() {
            return Err(CommandError::usage("abel: --weighted goes with --method daun, basex or fourier."));
        }
        Ok(Settings { method, elements, strength, centre, pixel_m, weighted })
    }

    /// The curve of growth that was given, or a gray band's.
    ///
    /// # Errors
    ///
    /// Status 2 for a table that is none.
    pub(super) fn growth(&self) -> Result<Growth, CommandError> {
        let Some(path) = &self.growth else { return Ok(Growth::gray()) };
        let table = TextTable::read(path)?;
        let column = |name: &str| table.numbers(name);
        Growth::new(&column("weight")?, &column("k")?)
            .map_err(|why| CommandError::usage(format!("abel: {}: {why}.", path.display())))
    }
}

/// Runs the command.
///
/// # Errors
///
/// Status 2 for arguments or arrays that make no sense, 1 for output that cannot be written.
pub fn run(args: &Args) -> CommandResult {
    let settings = args.how.settings(args.method)?;
    if args.how.growth.is_some() && !args.emissivity {
        return Err(CommandError::usage("abel: --growth is for emissivities: give --emissivity too."));
    }
    if settings.weighted && args.sigma.is_none() {
        return Err(CommandError::usage("abel: --weighted weights by σ: give --sigma too."));
    }
    let (shape, mut values) = image(&args.input)?;
    let [rows, columns] = shape;
    let mut sigmas = args.sigma.as_deref().map(|path| alike(path, shape)).transpose()?;
    let mut opaque = vec![false; values.len()];
    if args.emissivity {
        let depths = args.how.growth()?.depths(&values, sigmas.as_deref());
        (values, opaque) = (depths.depth, depths.opaque);
        sigmas = sigmas.map(|_| depths.sigma);
    }
    let wrong =
        |error: abel::AbelError| CommandError::usage(format!("abel {}: {error}.", args.input.display()));
    let seen = Columns { values: &values, sigmas: sigmas.as_deref(), rows, columns };
    let mut found = abel::invert(&seen, &settings).map_err(wrong)?;
    mark_opaque(&mut found, &opaque);
    let mut arrays = arrays(&found);
    if let Some(path) = &args.emission {
        let light = alike(path, shape)?;
        let sigmas = args.emission_sigma.as_deref().map(|path| alike(path, shape)).transpose()?;
        let light = Columns { values: &light, sigmas: sigmas.as_deref(), rows, columns };
        let sources = emission::sources(&light, &found, settings.pixel_m).map_err(wrong)?;
        let plane = |values: Vec<f64>| Array { shape: shape.to_vec(), values: Values::F64(values) };
        arrays.push(("source", plane(sources.source)));
        arrays.push(("sigma_source", plane(sources.sigma_source)));
    }
    if let Some(out) = &args.out {
        write(out, &arrays)?;
    }
    let summary = summary(&found, &settings);
    if args.json {
        return print(&(serde_json::to_string_pretty(&summary).expect("numbers and texts") + "\n"));
    }
    let written = args.out.as_ref().map_or_else(String::new, |out| format!("written to {}\n", out.display()));
    print(&(readable(&found, &settings) + &written))
}

/// An image: one row, or rows.
fn image(path: &Path) -> Result<([usize; 2], Vec<f64>), CommandError> {
    let array = npy::read(path).map_err(|error| CommandError::usage(format!("abel: {error}")))?;
    let shape = match array.shape[..] {
        [columns] => [1, columns],
        [rows, columns] => [rows, columns],
        _ => {
            return Err(CommandError::usage(format!(
                "abel: {}: has the shape {:?}, expected [rows, columns].",
                path.display(),
                array.shape
            )));
        }
    };
    Ok((shape, array.to_f64()))
}

fn alike(path: &Path, shape: [usize; 2]) -> Result<Vec<f64>, CommandError> {
    let (own, values) = image(path)?;
    if own == shape {
        return Ok(values);
    }
    Err(CommandError::usage(format!("abel: {}: has the shape {own:?}, the input {shape:?}.", path.display())))
}

/// Flags what was opaque: it has no column.
pub(super) fn mark_opaque(found: &mut Inverted, opaque: &[bool]) {
    let some = found.flags.iter_mut().zip(opaque).filter(|(_, opaque)| **opaque);
    some.for_each(|(flags, _)| *flags |= flag::OPAQUE);
}

/// The arrays of an inverted image.
pub(super) fn arrays(found: &Inverted) -> Vec<(&'static str, Array)> {
    let shape = vec![found.rows, found.columns];
    let plane = |values: &[f64]| Array { shape: shape.clone(), values: Values::F64(values.to_vec()) };
    let line = |values: &[f64]| Array { shape: vec![values.len()], values: Values::F64(values.to_vec()) };
    vec![
        ("alpha_per_m", plane(&found.alpha_per_m)),
        ("sigma_alpha", plane(&found.sigma_alpha)),
        ("centre_column", Array { shape: Vec::new(), values: Values::F64(vec![found.axis.column]) }),
        ("flags", Array { shape: shape.clone(), values: Values::U32(found.flags.clone()) }),
        ("strength", line(&found.strength)),
    ]
}

/// Writes arrays as NPZ.
///
/// # Errors
///
/// Status 1 when the disk refuses.
pub(super) fn write(path: &Path, arrays: &[(&str, Array)]) -> Result<(), CommandError> {
    let failed = |why: String| CommandError::failure(format!("abel: {}: {why}", path.display()));
    let named: Vec<(&str, &Array)> = arrays.iter().map(|(name, array)| (*name, array)).collect();
    let bytes = npz::to_bytes(&named, Packing::Stored).map_err(|error| failed(error.to_string()))?;
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(|error| failed(error.to_string()))?;
    }
    write_atomic(path, &bytes).map_err(|error| CommandError::failure(format!("abel: {error}")))
}

/// What was done, as JSON.
pub(super) fn summary(found: &Inverted, settings: &Settings) -> Value {
    let flags: serde_json::Map<String, Value> =
        found.flag_counts().into_iter().map(|(name, count)| (name.to_owned(), count.into())).collect();
    let legend: Vec<Value> = flag::LEGEND
        .iter()
        .map(|(bit, name, meaning)| json!({ "bit": bit, "name": name, "meaning": meaning }))
        .collect();
    json!({
        "schema": 1,
        "method": settings.method.name(),
        "elements": matches!(settings.method, Method::Daun | Method::DaunNonNegative).then_some(settings.elements),
        "rows": found.rows,
        "columns": found.columns,
        "pixel_m": settings.pixel_m,
        "centre_column": found.axis.column,
        "centre_sigma": number(found.axis.sigma),
        "centre_found": found.axis.found,
        "strength": settings.method.has_strength().then(|| spread(&found.strength)),
        "discrepancy_failed_rows": found.discrepancy_failed,
        "alpha_per_m": spread(&found.alpha_per_m),
        "sigma_alpha": spread(&found.sigma_alpha),
        "flags": flags,
        "flag_legend": legend,
    })
}

fn number(value: f64) -> Value {
    serde_json::Number::from_f64(value).map_or(Value::Null, Value::Number)
}

/// Least, middle and greatest of the finite values.
fn spread(values: &[f64]) -> Value {
    let mut finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    finite.sort_unstable_by(f64::total_cmp);
    let at = |index: usize| finite.get(index).copied();
    let last = finite.len().saturating_sub(1);
    json!({ "finite": finite.len(), "min": at(0), "median": at(last / 2), "max": at(last) })
}

/// The same for people.
pub(super) fn readable(found: &Inverted, settings: &Settings) -> String {
    let axis = &found.axis;
    let how = if axis.found {
        format!("found, ± {:.3}", axis.sigma)
    } else if settings.centre.is_some() {
        "given".to_owned()
    } else {
        "the middle: the picture does not tell".to_owned()
    };
    let mut text = format!(
        "{} x {} pixels, {}, axis at column {:.3} ({how})\n",
        found.rows,
        found.columns,
        settings.method.name(),
        axis.column
    );
    if settings.method.has_strength() {
        let strength = spread(&found.strength);
        text +=
            &format!("strength {} … {}, median {}\n", strength["min"], strength["max"], strength["median"]);
    }
    if found.discrepancy_failed > 0 {
        text += &format!(
            "in {} rows the residuals do not fit σ: cross-validation chose the strength\n",
            found.discrepancy_failed
        );
    }
    for (name, pixels) in found.flag_counts().into_iter().filter(|(_, pixels)| *pixels > 0) {
        text += &format!("  {pixels:8} pixels {name}\n");
    }
    text
}
