//! The keys of `[medium] kind = "cfd"` that say how the CFD's files are meant: unit of length, fuel's field, sectors, and the
//! edge of the grid's cells. The spray is a pair of CSV files of a few cells whose sums are known.

#![expect(clippy::unwrap_used, reason = "helpers of tests may fail loudly too")]

use ditd_sim::scene::deposit::DepositReport;
use ditd_sim::scene::file::{self, MediumSource, Scene, SceneError};
use ditd_sim::scene::optics::OpticsOptions;
use ditd_sim::tracer::medium::GridMedium;
use std::fmt::Write as _;
use std::path::Path;

/// Cells along an edge of the mesh, of 1 mm each.
const CELLS: u32 = 8;
/// Parcels, each of 1000 droplets of 10 µm.
const PARCELS: u32 = 200;

/// Writes the spray with lengths in a unit of so many metres that the files do not name. The gas has two fractions, of which
/// `Zfuel` is half of `C7H16`. All lies at x, y > 0.
fn write(folder: &Path, unit_m: f64) {
    let mut cells = String::from("x_min,y_min,z_min,x_max,y_max,z_max,T,p,C7H16,Zfuel\n");
    for i in 0..CELLS.pow(3) {
        let at = [i / 64, i / 8 % 8, i % 8].map(|c| f64::from(c) * 1e-3);
        let place = |a: usize, edge: f64| (at[a] - [0.0, 0.0, 8e-3][a] + edge) / unit_m;
        let fraction = 0.02 + 0.01 * f64::from(i % 5);
        let [low, high] = [0.0, 1e-3].map(|edge| [0, 1, 2].map(|a| place(a, edge)));
        let row = low.iter().chain(&high).map(f64::to_string).collect::<Vec<_>>().join(",");
        writeln!(cells, "{row},450,400000,{fraction},{}", 0.5 * fraction).unwrap();
    }
    let mut parcels = String::from("x,y,z,d_um,T,nParticle\n");
    for i in 0..PARCELS {
        let part = |by: f64| (f64::from(i) * by).fract();
        let [x, y, z] = [0.618_034, 0.754_878, 0.569_840].map(|by| 7.9e-3 * part(by) + 5e-5);
        writeln!(parcels, "{},{},{},10,380,1000", x / unit_m, y / unit_m, (z - 8e-3) / unit_m).unwrap();
    }
    std::fs::create_dir_all(folder).unwrap();
    std::fs::write(folder.join("cells.csv"), cells).unwrap();
    std::fs::write(folder.join("parcels.csv"), parcels).unwrap();
}

/// The scene of the spray in files of this unit, with further keys.
fn scene(unit_m: f64, keys: &str) -> Result<Scene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("case"), unit_m);
    let path = folder.path().join("scene.toml");
    let text = format!(
        "[band]\nwavelength_um = 3.4\n\n[medium]\nkind = \"cfd\"\npath = \"case\"\nfuel = \"n-heptane\"\n{keys}"
    );
    std::fs::write(&path, text).unwrap();
    file::load(&path).and_then(|scene| scene.with_spray(&OpticsOptions::default()))
}

fn made(unit_m: f64, keys: &str) -> (GridMedium, DepositReport) {
    let scene = scene(unit_m, keys).unwrap_or_else(|e| panic!("{keys}: {e}"));
    let Some(MediumSource::Spectral(medium, _)) = scene.medium else { panic!("a spray has coefficients") };
    (*medium, scene.deposit.unwrap())
}

fn close(found: f64, expected: f64, within: f64, what: &str) {
    assert!((found / expected - 1.0).abs() < within, "{what}: {found} where {expected} is expected");
}

/// Sum over the medium of extinction times volume, m².
fn extinction_m2(medium: &GridMedium) -> f64 {
    let volume: f64 =
        (0..3).map(|a| (medium.upper_m[a] - medium.lower_m[a]) / medium.cells[a] as f64).product();
    medium.k_ext.iter().sum::<f64>() * volume
}

#[test]
fn length_unit_m_scales_the_files_and_nothing_else() {
    let (metres, report) = made(1.0, "");
    let (millimetres, same) = made(1e-3, "length_unit_m = 0.001\n");
    assert_eq!(metres.cells, millimetres.cells);
    for a in 0..3 {
        // Places went through decimal text in another unit.
        assert!((metres.lower_m[a] - millimetres.lower_m[a]).abs() < 1e-12);
        assert!((metres.upper_m[a] - millimetres.upper_m[a]).abs() < 1e-12);
    }
    close(extinction_m2(&millimetres), extinction_m2(&metres), 1e-9, "extinction");
    close(same.vapour_mol, report.vapour_mol, 1e-9, "vapour");
    assert_eq!((same.droplets, report.droplets), (2e5, 2e5));
    for unit in ["0.0", "-1.0", "nan", "inf"] {
        let error = scene(1.0, &format!("length_unit_m = {unit}\n")).unwrap_err().to_string();
        assert!(error.contains("length_unit_m") && error.contains("positive"), "{error}");
    }
}

#[test]
fn fuel_field_names_the_fraction_that_is_the_fuel() {
    let (_, by_name) = made(1.0, "");
    let (_, said) = made(1.0, "fuel_field = \"C7H16\"\n");
    close(said.vapour_mol, by_name.vapour_mol, 1e-15, "the only name of a fuel");
    // Half of the mass fraction; the name tells no molar mass, so that the scene's fuel gives it. The density follows from the
    // pressure: with M̄ = 1/(Y/M + (1 − Y)/M_N2), up to 0.06·(1 − 28/100)/2 = 2 % less gas in the same volume.
    let (_, other) = made(1.0, "fuel_field = \"Zfuel\"\n");
    let ratio = other.vapour_mol / by_name.vapour_mol;
    assert!((0.478..0.5).contains(&ratio), "{ratio}");
    let error = scene(1.0, "fuel_field = \"C8H18\"\n").unwrap_err().to_string();
    assert!(error.contains("C8H18") && error.contains("Zfuel"), "{error}");
}

#[test]
fn sectors_make_the_whole_about_the_axis() {
    let (quarter, of_quarter) = made(1.0, "cell_m = 0.001\n");
    let (whole, of_whole) = made(1.0, "cell_m = 0.001\nsectors = 4\ntip_m = [0, 0, 0]\naxis = [0, 0, -1]\n");
    close(of_whole.droplets, 4.0 * of_quarter.droplets, 1e-12, "droplets");
    close(of_whole.vapour_mol, 4.0 * of_quarter.vapour_mol, 1e-12, "vapour");
    close(extinction_m2(&whole), 4.0 * extinction_m2(&quarter), 1e-6, "extinction");
    for a in 0..2 {
        assert!(whole.lower_m[a] < -7.9e-3 && whole.upper_m[a] > 7.9e-3, "{:?}", whole.lower_m);
    }
    // Turned copies: what is at (x, y) is at (−y, x) too.
    let at = |cell: [usize; 3]| {
        let ordinal = whole.index[(cell[0] * whole.cells[1] + cell[1]) * whole.cells[2] + cell[2]];
        whole.k_ext.get(ordinal as usize).copied().unwrap_or(0.0)
    };
    assert_eq!(whole.cells[0], whole.cells[1]);
    let (n, mut seen) = (whole.cells[0], 0);
    for x in 0..n {
        for y in 0..n {
            for z in 0..whole.cells[2] {
                let (one, turned) = (at([x, y, z]), at([n - 1 - y, x, z]));
                assert!((one - turned).abs() <= 1e-6 * one.max(turned), "{x} {y} {z}: {one} {turned}");
                seen += usize::from(one > 0.0);
            }
        }
    }
    assert!(seen > 4 * 512, "{seen}");
    for (keys, word) in [
        ("sectors = 4\n", "axis"),
        ("sectors = 0\naxis = [0, 0, -1]\n", "sectors"),
        ("sectors = 65\naxis = [0, 0, -1]\n", "sectors"),
    ] {
        let error = scene(1.0, keys).unwrap_err().to_string();
        assert!(error.contains(word), "{keys}: {error}");
    }
}

#[test]
fn cell_m_is_the_largest_edge_of_a_cell_and_moves_nothing() {
    let (_, automatic) = made(1.0, "");
    for edge_m in [0.4e-3, 1e-3, 2.1e-3] {
        let (medium, report) = made(1.0, &format!("cell_m = {edge_m}\n"));
        for a in 0..3 {
            let edge = (medium.upper_m[a] - medium.lower_m[a]) / medium.cells[a] as f64;
            assert!(edge <= edge_m * (1.0 + 1e-9) && edge > 0.7 * edge_m, "{edge} for {edge_m}");
            assert!((edge / report.cell_m[a] - 1.0).abs() < 1e-9);
        }
        close(report.droplets, automatic.droplets, 1e-12, "droplets");
        close(report.vapour_mol, automatic.vapour_mol, 1e-9, "vapour");
    }
    for edge in ["0.0", "-0.001", "nan", "1e-7"] {
        assert!(scene(1.0, &format!("cell_m = {edge}\n")).is_err(), "{edge}");
    }
}
