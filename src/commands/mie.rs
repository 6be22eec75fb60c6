//! `ditd mie`: scattering of spheres, tables in, tables out; pictures of them.

mod figure;

use super::{CommandError, CommandResult};
use crate::report::mie as pictures;
use crate::report::plot::sheet::{Drawing, Sheet};
use crate::tables::TextTable;
use ditd_sim::light::mie::{self, Direction, Efficiencies, Lognormal, Sphere};
use std::path::{Path, PathBuf};

/// Relative accuracy of means over a size distribution.
const POLYDISPERSE_TARGET: f64 = 1e-10;

/// Arguments of `ditd mie`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, clap::Subcommand)]
enum Task {
    /// Columns x, n, k; adds qext, qsca, qabs, qback, g
    Efficiencies(EfficienciesInput),
    /// Columns x, n, k, theta_deg; adds s1_re, s1_im, s2_re, s2_im, p11 (NaN where nothing is scattered)
    Amplitudes(Input),
    /// Columns x, n, k, theta_deg; adds cdf, the fraction scattered within theta (NaN where nothing is scattered)
    Cdf(Input),
    /// Columns r_g_um, sigma_ln, lambda_um, n, k; adds qext_mean, qsca_mean, qabs_mean, g_mean
    Polydisperse(Input),
    /// Draw a liquid: efficiencies and mean cosine against the radius, phase functions
    Figure(figure::Args),
}

#[derive(Debug, clap::Args)]
struct Input {
    /// Table with a header line; `-` is standard input. Other columns are carried through
    #[arg(value_name = "FILE.csv")]
    file: PathBuf,
    /// Print a list of JSON objects instead
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct EfficienciesInput {
    #[command(flatten)]
    input: Input,
    /// Draw the efficiencies against x as well
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
///
/// Status 2, naming the row, when a table or a sphere makes no sense; 1 when a picture cannot be written.
pub fn run(args: Args) -> CommandResult {
    let (input, task): (Input, fn(&mut TextTable) -> CommandResult) = match args.task {
        Task::Efficiencies(EfficienciesInput { input, plot }) => {
            let mut table = TextTable::read(&input.file)?;
            efficiencies(&mut table, plot.as_deref())?;
            return table.print(input.json);
        }
        Task::Figure(args) => return figure::run(args),
        Task::Amplitudes(input) => (input, amplitudes),
        Task::Cdf(input) => (input, cdf),
        Task::Polydisperse(input) => (input, polydisperse),
    };
    let mut table = TextTable::read(&input.file)?;
    task(&mut table)?;
    table.print(input.json)
}

fn spheres(table: &TextTable) -> Result<Vec<Sphere>, CommandError> {
    let (x, n, k) = (table.numbers("x")?, table.numbers("n")?, table.numbers("k")?);
    Ok(x.into_iter().zip(n).zip(k).map(|((size_parameter, n), k)| Sphere { size_parameter, n, k }).collect())
}

fn efficiencies(table: &mut TextTable, plot: Option<&Path>) -> CommandResult {
    plot.map_or(Ok(()), figure::svg_named)?;
    let spheres = spheres(table)?;
    let (answers, _) =
        mie::efficiencies_refined(&spheres).map_err(|(index, error)| table.bad_row(index, error))?;
    let mut set = |name: &str, value: fn(&Efficiencies) -> f64| {
        table.set(name, &answers.iter().map(value).collect::<Vec<f64>>());
    };
    set("qext", |q| q.q_ext);
    set("qsca", |q| q.q_sca);
    set("qabs", |q| q.q_abs);
    set("qback", |q| q.q_back);
    set("g", |q| q.asymmetry);
    if let Some(path) = plot {
        let drawing = Drawing::Plot(pictures::spheres(&spheres, &answers));
        figure::write(path, &Sheet { title: String::new(), drawings: vec![drawing], columns: 1 })?;
    }
    Ok(())
}

/// Rows with their directions, in stretches of one sphere.
fn stretches(table: &TextTable) -> Result<Vec<(Sphere, usize, Vec<Direction>)>, CommandError> {
    let theta = table.numbers("theta_deg")?;
    let mut stretches: Vec<(Sphere, usize, Vec<Direction>)> = Vec::new();
    for (row, (sphere, theta)) in spheres(table)?.into_iter().zip(theta).enumerate() {
        let direction = Direction::from_degrees(theta).map_err(|error| table.bad_row(row, error))?;
        match stretches.last_mut() {
            Some(stretch) if stretch.0 == sphere => stretch.2.push(direction),
            _ => stretches.push((sphere, row, vec![direction])),
        }
    }
    Ok(stretches)
}

fn amplitudes(table: &mut TextTable) -> CommandResult {
    let mut columns: [Vec<f64>; 5] = Default::default();
    for (sphere, row, towards) in stretches(table)? {
        let bad = |error| table.bad_row(row, error);
        let amplitudes = mie::amplitudes_towards(sphere, &towards).map_err(bad)?;
        let p11 = mie::phase(sphere, &towards).map_err(bad)?;
        for ((s1, s2), p11) in amplitudes.into_iter().zip(p11) {
            for (column, value) in columns.iter_mut().zip([s1.re, s1.im, s2.re, s2.im, p11]) {
                column.push(value);
            }
        }
    }
    for (name, column) in ["s1_re", "s1_im", "s2_re", "s2_im", "p11"].into_iter().zip(columns) {
        table.set(name, &column);
    }
    Ok(())
}

fn cdf(table: &mut TextTable) -> CommandResult {
    let mut column = Vec::new();
    for (sphere, row, towards) in stretches(table)? {
        let answers = mie::cumulative(sphere, &towards).map_err(|error| table.bad_row(row, error))?;
        column.extend(answers);
    }
    table.set("cdf", &column);
    Ok(())
}

fn polydisperse(table: &mut TextTable) -> CommandResult {
    let input = ["r_g_um", "sigma_ln", "lambda_um", "n", "k"];
    let input = input.map(|name| table.numbers(name));
    let [radius, sigma, lambda, n, k] = input;
    let (radius, sigma, lambda, n, k) = (radius?, sigma?, lambda?, n?, k?);
    let mut columns: [Vec<f64>; 4] = Default::default();
    for row in 0..table.len() {
        let sizes = Lognormal { median_radius_um: radius[row], sigma_ln: sigma[row] };
        let means = mie::lognormal(sizes, lambda[row], n[row], k[row], POLYDISPERSE_TARGET)
            .map_err(|error| table.bad_row(row, error))?;
        if means.error > POLYDISPERSE_TARGET {
            eprintln!(
                "ditd mie: row {}: still moving by {:.1e} with {} radii",
                row + 1,
                means.error,
                means.radii
            );
        }
        for (column, value) in
            columns.iter_mut().zip([means.q_ext, means.q_sca, means.q_abs, means.asymmetry])
        {
            column.push(value);
        }
    }
    for (name, column) in ["qext_mean", "qsca_mean", "qabs_mean", "g_mean"].into_iter().zip(columns) {
        table.set(name, &column);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> TextTable {
        TextTable::parse("t", text).unwrap()
    }

    #[test]
    fn a_table_of_spheres_gets_its_columns_in_its_own_order() {
        let mut own = table("id,x,n,k\nbig,50,1.4,0.1\nnone,0,1.4,0.1\nsmall,0.1,1.4,0.1\n");
        efficiencies(&mut own, None).unwrap();
        let q = own.numbers("qext").unwrap();
        assert!(q[0] > 2.0 && q[1] == 0.0 && q[2] < 0.1, "{q:?}");
        assert!(own.to_csv().starts_with("id,x,n,k,qext,qsca,qabs,qback,g\nbig,50,1.4,0.1,"));
    }

    #[test]
    fn the_row_of_a_bad_sphere_is_named() {
        let error = efficiencies(&mut table("x,n,k\n50,1.4,0.1\n1,1.4,-0.1\n"), None).unwrap_err();
        assert!(error.code == 2 && error.message.starts_with("t, row 2: index 1.4 + -0.1 i"), "{error}");
        let error = amplitudes(&mut table("x,n,k,theta_deg\n50,1.4,0.1,0\n50,1.4,0.1,181\n")).unwrap_err();
        assert!(error.message.starts_with("t, row 2: scattering angle"), "{error}");
        let error = cdf(&mut table("x,n,k,theta_deg\n-1,1.4,0.1,0\n")).unwrap_err();
        assert!(error.message.starts_with("t, row 1: size parameter -1"), "{error}");
        let header = "r_g_um,sigma_ln,lambda_um,n,k";
        let error = polydisperse(&mut table(&format!("{header}\n0,0.5,3.4,1.4,0.1\n"))).unwrap_err();
        assert!(error.message.starts_with("t, row 1: lognormal"), "{error}");
    }

    #[test]
    fn stretches_of_one_sphere_keep_the_order_of_the_rows() {
        let mut own = table("x,n,k,theta_deg\n5,1.4,0.1,0\n5,1.4,0.1,180\n6,1.4,0.1,0\n5,1.4,0.1,0\n");
        amplitudes(&mut own).unwrap();
        cdf(&mut own).unwrap();
        let (s1, cdf) = (own.numbers("s1_re").unwrap(), own.numbers("cdf").unwrap());
        assert_eq!(s1[0].to_bits(), s1[3].to_bits());
        assert_ne!(s1[2].to_bits(), s1[0].to_bits());
        assert!(cdf[0] == 0.0 && (cdf[1] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_distribution_gets_its_means() {
        let mut own = table("r_g_um,sigma_ln,lambda_um,n,k\n5.0,0.5,3.4,1.38,0.09\n");
        polydisperse(&mut own).unwrap();
        // Reference table of polydisperse means, first row.
        assert!((own.numbers("qext_mean").unwrap()[0] / 2.351412090567 - 1.0).abs() < 1e-9);
    }
}
