//! `ditd mie figure`: the page of one liquid, as the paper's Fig. 2 shows it.

use crate::commands::{CommandError, CommandResult};
use crate::files::write_atomic;
use crate::report::mie::{Droplets, round_radii, sheet};
use crate::report::plot::sheet::Sheet;
use ditd_sim::light::fuel::Fuel;
use std::path::{Path, PathBuf};

/// Largest size parameter of a figure: a thousand spheres are computed, and patterns of up to 5760 angles.
const SIZE_MAX: f64 = 2e4;

/// Arguments of `ditd mie figure`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Real part of the index
    #[arg(long, default_value_t = 1.38, allow_negative_numbers = true, conflicts_with = "fuel")]
    n: f64,
    /// Imaginary part of the index, not negative
    #[arg(long, default_value_t = 0.09, allow_negative_numbers = true, conflicts_with = "fuel")]
    k: f64,
    /// A shipped fuel instead of an index
    #[arg(long, value_name = "NAME")]
    fuel: Option<String>,
    /// Temperature of the liquid fuel
    #[arg(long, value_name = "K", default_value_t = 353.0, allow_negative_numbers = true, requires = "fuel")]
    temperature_k: f64,
    /// Wavelength
    #[arg(long, value_name = "UM", default_value_t = 3.4, allow_negative_numbers = true)]
    wavelength_um: f64,
    /// Smallest and largest radius
    #[arg(long, value_name = "LOW..HIGH", default_value = "0.1..50", value_parser = range)]
    radius_um: (f64, f64),
    /// Radii whose phase function is drawn, separated by commas (up to 5; round ones of the range if not given)
    #[arg(long, value_name = "R,R,…", value_delimiter = ',', num_args = 1..)]
    patterns_um: Vec<f64>,
    /// The picture
    #[arg(long, value_name = "FILE.svg")]
    out: PathBuf,
}

fn range(text: &str) -> Result<(f64, f64), String> {
    let (low, high) = text.split_once("..").ok_or("two numbers with .. between them, e.g. 0.1..50")?;
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| format!("`{text}` is not a number"));
    Ok((number(low)?, number(high)?))
}

/// Runs the command.
///
/// # Errors
///
/// Status 2 when a value makes no sense, 1 when the file cannot be written.
pub(super) fn run(args: Args) -> CommandResult {
    let out = args.out.clone();
    let sheet =
        sheet(&droplets(args)?).map_err(|error| CommandError::usage(format!("mie figure: {error}")))?;
    write(&out, &sheet)
}

/// Writes a page.
///
/// # Errors
///
/// Status 2 for a name that does not end with .svg, 1 when the file cannot be written.
pub(super) fn write(path: &Path, sheet: &Sheet) -> CommandResult {
    svg_named(path)?;
    write_atomic(path, sheet.to_svg().as_bytes())
        .map_err(|error| CommandError::failure(format!("writing the picture: {error}")))
}

/// Refuses other kinds of pictures.
pub(super) fn svg_named(path: &Path) -> CommandResult {
    if path.extension().is_some_and(|end| end.eq_ignore_ascii_case("svg")) {
        return Ok(());
    }
    Err(CommandError::usage(format!("{}: pictures are written as .svg", path.display())))
}

fn droplets(args: Args) -> Result<Droplets, CommandError> {
    let bad = |what: String| CommandError::usage(format!("mie figure: {what}"));
    let Args { wavelength_um, radius_um, temperature_k, .. } = args;
    if !(wavelength_um > 0.0 && wavelength_um.is_finite()) {
        return Err(bad(format!("wavelength {wavelength_um} um: it must be above 0")));
    }
    let (low, high) = radius_um;
    if !(low > 0.0 && high > low && high.is_finite()) {
        return Err(bad(format!("radii {low}..{high} um: both must be above 0, the second larger")));
    }
    let (name, n, k) = match &args.fuel {
        None => ("sphere".to_owned(), args.n, args.k),
        Some(name) => {
            let fuel = Fuel::named(name).map_err(|error| bad(error.to_string()))?;
            let [from, to] = fuel.liquid_range_um();
            if !(from..=to).contains(&wavelength_um) {
                return Err(bad(format!(
                    "wavelength {wavelength_um} um: the index of {name} is known from {from} to {to} um"
                )));
            }
            if !(temperature_k > 0.0 && temperature_k.is_finite()) {
                return Err(bad(format!("temperature {temperature_k} K: it must be above 0")));
            }
            let (n, k) = fuel.liquid_index(wavelength_um, temperature_k);
            (format!("{name} at {temperature_k} K"), n, k)
        }
    };
    let patterns_um =
        if args.patterns_um.is_empty() { round_radii(radius_um, wavelength_um) } else { args.patterns_um };
    if patterns_um.len() > 5 || patterns_um.iter().any(|r| !(*r > 0.0 && r.is_finite())) {
        return Err(bad("--patterns-um takes up to 5 radii above 0".to_owned()));
    }
    let largest = patterns_um.iter().fold(high, |a, &b| a.max(b));
    let size_parameter = 2.0 * std::f64::consts::PI * largest / wavelength_um;
    if size_parameter * n.hypot(k).max(1.0) > SIZE_MAX {
        return Err(bad(format!(
            "radius {largest} um is a size parameter of {size_parameter:.0}: more than {SIZE_MAX} (or |m| times that) is not drawn"
        )));
    }
    Ok(Droplets { name, n, k, wavelength_um, radius_um, patterns_um })
}
