//! Sprays of OpenFOAM v1912 in every form we read, against totals and maps computed from the same data by
//! programs that we did not write (VTK's readers and the solver's own log): see the data's `reference.json`.
//!
//! The samples are real files, packed one by one to keep the repository small; a test unpacks what it reads.

#![expect(clippy::unwrap_used, reason = "helpers of tests may fail loudly too")]

use ditd_sim::scene::compact;
use ditd_sim::scene::deposit::{self, DepositOptions, Move, Placement};
use ditd_sim::scene::field::{CfdSpray, Parcel, SprayField, Totals};
use ditd_sim::scene::import::{self, ImportOptions, SceneError, Time};
use std::fmt::Write as _;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Unpacks one form of the single-hole spray, or two, into a fresh folder.
fn sample(form: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cfd/singlehole_5bar_540K").join(form);
    unpack(&source, &folder.path().join(form));
    let path = folder.path().join(form);
    (folder, path)
}

fn unpack(source: &Path, target: &Path) {
    std::fs::create_dir_all(target).unwrap();
    for entry in std::fs::read_dir(source).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        if entry.path().is_dir() {
            unpack(&entry.path(), &target.join(name));
            continue;
        }
        let packed = std::fs::read(entry.path()).unwrap();
        let mut bytes = Vec::new();
        flate2::read::GzDecoder::new(packed.as_slice()).read_to_end(&mut bytes).unwrap();
        std::fs::write(target.join(name.strip_suffix(".gz").unwrap()), bytes).unwrap();
    }
}

fn read(path: &Path) -> CfdSpray {
    import::read(path, Time::Latest, &ImportOptions::default()).unwrap()
}

fn reference(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cfd/singlehole_5bar_540K/reference");
    std::fs::read_to_string(folder.join(name)).unwrap()
}

/// A total: what it is, its value in the reference, and where we have it.
type Expected = (&'static str, f64, fn(&Totals) -> Option<f64>);

fn expected(time: &str) -> Vec<Expected> {
    let all: serde_json::Value = serde_json::from_str(&reference("reference.json")).unwrap();
    let of = |key: &str| all["times"][time][key].as_f64().unwrap();
    vec![
        ("parcels", of("parcels"), |t| t.parcels.map(|n| n as f64)),
        ("droplets", of("droplets"), |t| t.droplets),
        ("liquid mass", of("liquid_mass_kg"), |t| t.liquid_mass_kg),
        ("area", of("geom_area_m2"), |t| t.geometric_area_m2),
        ("D10", of("D10_um"), |t| t.d10_um),
        ("D32", of("D32_um"), |t| t.d32_um),
        ("d min", of("d_min_um"), |t| t.d_min_um),
        ("d max", of("d_max_um"), |t| t.d_max_um),
        ("T liquid min", of("T_liq_min"), |t| t.t_liquid_min_k),
        ("T liquid mean", of("T_liq_mass_mean"), |t| t.t_liquid_mean_k),
        ("T liquid max", of("T_liq_max"), |t| t.t_liquid_max_k),
        ("cells", all["n_cells"].as_f64().unwrap(), |t| t.cells.map(|n| n as f64)),
        ("gas volume", all["volume_m3"].as_f64().unwrap(), |t| t.gas_volume_m3),
        ("vapour mass", of("vapour_mass_kg"), |t| t.vapour_mass_kg),
        ("T gas min", of("T_gas_min"), |t| t.t_gas_min_k),
        ("T gas max", of("T_gas_max"), |t| t.t_gas_max_k),
        ("T gas mean", of("T_gas_vapour_mean"), |t| t.t_gas_vapour_mean_k),
    ]
}

#[test]
fn totals_of_every_form_equal_the_reference() {
    // Numbers of the forms: double, single precision (6e-8), six digits of text (1e-6 each).
    for (form, time, tolerance) in [
        ("openfoam", "0.0007", 1e-12),
        ("openfoam_decomposed", "0.0007", 1e-12),
        ("vtk_xml", "0.0007", 2e-7),
        ("vtk_legacy", "0.0003", 2e-7),
        ("ensight_ascii", "0.0012", 2e-6),
    ] {
        let (_keep, path) = sample(form);
        let seconds: f64 = time.parse().unwrap();
        let times = import::list(&path).unwrap();
        assert!(times.len() == 1 && (times[0] / seconds - 1.0).abs() < 1e-9, "{form}: {times:?}");
        let totals = read(&path).totals();
        for (what, expected, of) in expected(time) {
            let found = of(&totals).unwrap();
            let error = (found / expected - 1.0).abs();
            assert!(error < tolerance, "{form}: {what}: {found} against {expected}, off by {error:.1e}");
        }
    }
}

#[test]
fn the_shipped_spray_has_the_totals_of_its_source() {
    // reference.json of the eight-hole spray, 0.9 ms.
    let totals = compact::shipped().unwrap().totals();
    let close = |found: Option<f64>, expected: f64| {
        let error = (found.unwrap() / expected - 1.0).abs();
        assert!(error < 1e-6, "{found:?} against {expected}: {error:.1e}");
    };
    assert_eq!((totals.parcels, totals.cells), (Some(22_528), Some(101_568)));
    close(totals.droplets, 7_165_494.911956);
    close(totals.liquid_mass_kg, 2.5697152721491456e-6);
    close(totals.geometric_area_m2, 0.00048683865605710314);
    close(totals.d10_um, 8.088706185280373);
    close(totals.d32_um, 13.010461261776372);
    close(totals.d_min_um, 0.2450125);
    close(totals.d_max_um, 65.77886);
    close(totals.t_liquid_min_k, 362.0457);
    close(totals.t_liquid_max_k, 434.6699);
    close(totals.vapour_mass_kg, 6.682263526262232e-6);
    close(totals.t_gas_min_k, 402.8296);
    close(totals.t_gas_max_k, 522.2153);
    close(totals.t_gas_vapour_mean_k, 440.570176216029);
    assert_eq!(totals.junk_parcels, Some(3));
}

fn by_size(parcels: &[Parcel]) -> Vec<Parcel> {
    let mut sorted = parcels.to_vec();
    sorted.sort_by(|a, b| a.diameter_m.total_cmp(&b.diameter_m).then(a.droplets.total_cmp(&b.droplets)));
    sorted
}

fn farthest(one: &[Parcel], other: &[Parcel]) -> f64 {
    assert_eq!(one.len(), other.len());
    let apart = |(a, b): (&Parcel, &Parcel)| {
        (0..3).map(|i| (a.position_m[i] - b.position_m[i]).abs()).fold(0.0, f64::max)
    };
    one.iter().zip(other).map(apart).fold(0.0, f64::max)
}

#[test]
fn barycentric_coordinates_give_the_written_positions() {
    let (_keep, path) = sample("openfoam");
    let written = read(&path).parcels.unwrap();
    std::fs::remove_file(path.join("0.0007/lagrangian/sprayCloud/positions")).unwrap();
    let decoded = read(&path).parcels.unwrap();
    assert!(farthest(&written, &decoded) < 1e-15, "{}", farthest(&written, &decoded));

    let (_keep, path) = sample("openfoam_decomposed");
    let pieces = read(&path).parcels.unwrap();
    let far = farthest(&by_size(&written), &by_size(&pieces));
    assert!(far < 1e-15, "{far}");
}

/// Column mass of the vapour along z on the reference's 1 mm pixels, by exact projection of the boxes.
fn column_map(spray: &CfdSpray) -> Vec<Vec<f64>> {
    let (columns, rows, pixel) = (24, 72, 1e-3);
    let start = [-0.012000000104308128, 0.0];
    let mut map = vec![vec![0.0; columns]; rows];
    for cell in spray.cells.as_ref().unwrap() {
        let share = |axis: usize, index: usize| {
            let low = start[axis] + index as f64 * pixel;
            let overlap = cell.upper_m[axis].min(low + pixel) - cell.lower_m[axis].max(low);
            overlap.max(0.0) / (cell.upper_m[axis] - cell.lower_m[axis])
        };
        let shares: Vec<f64> = (0..columns).map(|c| share(0, c)).collect();
        for (row, line) in map.iter_mut().enumerate() {
            let along = share(1, row);
            if along > 0.0 {
                for (value, across) in line.iter_mut().zip(&shares) {
                    *value += cell.vapour_kg() * along * across / (pixel * pixel);
                }
            }
        }
    }
    map
}

#[test]
fn the_column_map_of_the_cells_equals_the_reference() {
    let (_keep, path) = sample("openfoam");
    let map = column_map(&read(&path));
    let text = reference("column_vapour_kg_m2_0.0007.csv");
    let peak = map.iter().flatten().copied().fold(0.0, f64::max);
    for (row, line) in text.lines().enumerate() {
        for (column, word) in line.split(',').enumerate() {
            let expected: f64 = word.parse().unwrap();
            let error = (map[row][column] - expected).abs();
            // The reference is written with five digits.
            assert!(
                error < 1e-4 * expected + 1e-7 * peak,
                "row {row}, column {column}: {error:.1e} of {expected}"
            );
        }
    }
}

#[test]
fn cut_off_files_are_refused_with_their_name_and_place() {
    for (form, file) in [
        ("openfoam", "constant/polyMesh/points"),
        ("openfoam", "constant/polyMesh/faces"),
        ("openfoam", "constant/polyMesh/neighbour"),
        ("openfoam", "0.0007/T"),
        ("openfoam", "0.0007/lagrangian/sprayCloud/positions"),
        ("openfoam", "0.0007/lagrangian/sprayCloud/d"),
        ("openfoam_decomposed", "processor2/0.0007/lagrangian/sprayCloud/coordinates"),
        ("ensight_ascii", "geometry"),
        ("ensight_ascii", "data/00000000/C7H16"),
        ("ensight_ascii", "data/00000000/lagrangian/sprayCloud/positions"),
        ("ensight_ascii", "data/00000000/lagrangian/sprayCloud/d"),
        ("vtk_xml", "openfoam_374/internal.vtu"),
        ("vtk_xml", "lagrangian/sprayCloud/sprayCloud_374.vtp"),
        ("vtk_legacy", "openfoam_153.vtk"),
    ] {
        let (_keep, path) = sample(form);
        let cut = path.join(file);
        let bytes = std::fs::read(&cut).unwrap();
        std::fs::write(&cut, &bytes[..bytes.len() * 6 / 10]).unwrap();
        let error = import::read(&path, Time::Latest, &ImportOptions::default()).unwrap_err();
        let SceneError::Malformed { file: named, .. } = &error else { panic!("{form}/{file}: {error}") };
        assert_eq!(named, &cut, "{error}");
    }
}

#[test]
fn what_is_no_spray_is_refused_and_says_what_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let text = folder.path().join("notes.txt");
    std::fs::write(&text, "hello").unwrap();
    for path in [folder.path().to_owned(), text, folder.path().join("nowhere")] {
        let error = import::list(&path).unwrap_err();
        assert!(
            matches!(error, SceneError::Unknown { .. }) && error.to_string().contains("EnSight"),
            "{error}"
        );
    }
    std::fs::create_dir(folder.path().join("processors4")).unwrap();
    assert!(import::list(folder.path()).unwrap().is_empty());
    let (_keep, path) = sample("openfoam");
    let error = import::read(&path, Time::At(0.1), &ImportOptions::default()).unwrap_err();
    assert!(matches!(&error, SceneError::Time { present, .. } if present == "0.0007"), "{error}");
    let block = path.join("x.vtm");
    std::fs::write(&block, "<VTKFile type='vtkMultiBlockDataSet'><DataSet file='away.vtu'/></VTKFile>")
        .unwrap();
    let error = import::read(&block, Time::Latest, &ImportOptions::default()).unwrap_err();
    assert!(matches!(&error, SceneError::Access { file, .. } if file.ends_with("away.vtu")), "{error}");
    std::fs::remove_file(path.join("0.0007/lagrangian/sprayCloud/d")).unwrap();
    let error = import::read(&path, Time::Latest, &ImportOptions::default()).unwrap_err();
    assert!(matches!(&error, SceneError::Missing { file, .. } if file.ends_with("d")), "{error}");
}

#[test]
fn a_file_of_another_mesh_is_refused_by_its_length() {
    let (_keep, path) = sample("openfoam");
    let head = "FoamFile { version 2.0; format ascii; class volScalarField; object T; }\n";
    std::fs::write(
        path.join("0.0007/T"),
        format!("{head}internalField nonuniform List<scalar> 2(300 301);\n"),
    )
    .unwrap();
    let error = import::read(&path, Time::Latest, &ImportOptions::default()).unwrap_err();
    assert!(matches!(error, SceneError::Length { expected: 17_272, found: 2, .. }), "{error}");
}

#[test]
fn numbers_that_are_none_are_refused_in_the_gas() {
    let (_keep, path) = sample("openfoam");
    let head = "FoamFile { version 2.0; format ascii; class volScalarField; object T; }\n";
    std::fs::write(path.join("0.0007/T"), format!("{head}internalField uniform nan;\n")).unwrap();
    let error = import::read(&path, Time::Latest, &ImportOptions::default()).unwrap_err();
    assert!(matches!(error, SceneError::Malformed { .. }), "{error}");
}

#[test]
fn density_follows_from_pressure_and_constant_fields_count_for_all_cells() {
    let (_keep, path) = sample("openfoam");
    let with_density = read(&path).totals();
    std::fs::remove_file(path.join("0.0007/rho")).unwrap();
    let without = read(&path).totals();
    let error = (without.vapour_mass_kg.unwrap() / with_density.vapour_mass_kg.unwrap() - 1.0).abs();
    assert!(error < 2e-6, "{error:.1e}: OpenFOAM's own density agrees to 1.4e-6");
    let head = "FoamFile { version 2.0; format ascii; class volScalarField; object T; }\n";
    std::fs::write(path.join("0.0007/T"), format!("{head}internalField uniform 500;\n")).unwrap();
    let constant = read(&path).totals();
    assert_eq!((constant.t_gas_min_k, constant.t_gas_max_k), (Some(500.0), Some(500.0)));
}

/// Writes 80 bytes.
fn text80(bytes: &mut Vec<u8>, text: &str) {
    bytes.extend(text.bytes().chain(std::iter::repeat(0)).take(80));
}

#[test]
fn binary_ensight_is_read_in_both_byte_orders() {
    for big_endian in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let int = |v: i32| if big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
        let float = |v: f32| if big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
        let mut geometry = Vec::new();
        for line in ["C Binary", "geometry", "by hand", "node id assign", "element id assign", "part"] {
            text80(&mut geometry, line);
        }
        geometry.extend(int(1));
        text80(&mut geometry, "mesh");
        text80(&mut geometry, "coordinates");
        geometry.extend(int(12));
        // Two boxes of 1 × 2 × 3 one after the other along z.
        let corners = [[0., 0.], [1., 0.], [1., 2.], [0., 2.]];
        let points: Vec<[f32; 3]> = (0..12_u8)
            .map(|i| [corners[usize::from(i) % 4][0], corners[usize::from(i) % 4][1], f32::from(i / 4) * 3.0])
            .collect();
        for axis in 0..3 {
            geometry.extend(points.iter().flat_map(|p| float(p[axis])));
        }
        text80(&mut geometry, "hexa8");
        geometry.extend(int(2));
        geometry.extend((1..=8).chain(5..=12).flat_map(int));
        std::fs::write(folder.path().join("geo"), geometry).unwrap();
        let element = |name: &str, values: [f32; 2]| {
            let mut bytes = Vec::new();
            text80(&mut bytes, name);
            text80(&mut bytes, "part");
            bytes.extend(int(1));
            text80(&mut bytes, "hexa8");
            bytes.extend(values.into_iter().flat_map(float));
            std::fs::write(folder.path().join(name), bytes).unwrap();
        };
        element("T", [450.0, 500.0]);
        element("rho", [2.0, 3.0]);
        element("C7H16", [0.25, 0.5]);
        let case = "FORMAT\ntype: ensight gold\nGEOMETRY\nmodel: geo\nVARIABLE\nscalar per element: T T\n\
                    scalar per element: rho rho\nscalar per element: C7H16 C7H16\n";
        std::fs::write(folder.path().join("x.case"), case).unwrap();
        let totals = read(folder.path()).totals();
        assert_eq!(totals.vapour_mass_kg, Some(6.0 * (2.0 * 0.25 + 3.0 * 0.5)), "big-endian: {big_endian}");
        assert_eq!((totals.cells, totals.t_gas_max_k, totals.parcels), (Some(2), Some(500.0), None));
    }
}

#[test]
fn a_csv_pair_in_other_units_gives_the_same_totals() {
    let (_keep, path) = sample("vtk_xml");
    let spray = read(&path);
    let folder = tempfile::tempdir().unwrap();
    let mut parcels = String::from("# time_s = 0.0007\nx_mm,y_mm,z_mm,d_um,T [C],nParticle,rho_kg_m3\n");
    for (p, rho) in spray.parcels.as_ref().unwrap().iter().zip(spray.liquid_density_kg_m3.as_ref().unwrap()) {
        let [x, y, z] = p.position_m.map(|v| v * 1e3);
        let (d, t, n) = (p.diameter_m * 1e6, p.temperature_k - 273.15, p.droplets);
        writeln!(parcels, "{x},{y},{z},{d},{t},{n},{rho}").unwrap();
    }
    let mut cells =
        String::from("x_min_mm,y_min_mm,z_min_mm,x_max_mm,y_max_mm,z_max_mm,T_K,p_bar,rho,C7H16\n");
    for c in spray.cells.as_ref().unwrap() {
        for v in c.lower_m.iter().chain(&c.upper_m) {
            write!(cells, "{},", v * 1e3).unwrap();
        }
        writeln!(
            cells,
            "{},{},{},{}",
            c.temperature_k,
            c.pressure_pa * 1e-5,
            c.density_kg_m3,
            c.fuel_mass_fraction
        )
        .unwrap();
    }
    std::fs::write(folder.path().join("parcels.csv"), &parcels).unwrap();
    std::fs::write(folder.path().join("cells.csv"), cells).unwrap();
    let totals = read(folder.path()).totals();
    for (what, expected, of) in expected("0.0007") {
        let error = (of(&totals).unwrap() / expected - 1.0).abs();
        assert!(error < 2e-7, "{what}: {error:.1e}");
    }
    assert_eq!(import::list(folder.path()).unwrap(), [0.0007]);
    std::fs::write(folder.path().join("parcels.csv"), parcels.replace(",nParticle", ",count of drops"))
        .unwrap();
    let error = import::read(folder.path(), Time::Latest, &ImportOptions::default()).unwrap_err();
    assert!(error.to_string().contains("count of drops"), "{error}");
}

#[test]
fn the_compact_form_keeps_what_it_promises_and_notices_damage() {
    let (_keep, path) = sample("openfoam");
    let spray = read(&path);
    let bytes = compact::pack(&spray);
    let name = Path::new("x.spray");
    let back = compact::unpack(&bytes, name).unwrap();
    let (one, other) = (spray.totals(), back.totals());
    for (what, _, of) in expected("0.0007") {
        let error = (of(&one).unwrap() / of(&other).unwrap() - 1.0).abs();
        assert!(error < 2.0 * compact::VAPOUR_LEFT_OUT, "{what}: {error:.1e}");
    }
    let left_out = back.remainder.unwrap();
    assert!(
        left_out.vapour_kg <= compact::VAPOUR_LEFT_OUT * one.vapour_mass_kg.unwrap() && left_out.cells > 1000
    );
    assert!(farthest(spray.parcels.as_ref().unwrap(), back.parcels.as_ref().unwrap()) < 4e-9);
    // Packing what was unpacked changes nothing.
    assert_eq!(compact::pack(&back), bytes);

    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 1;
    assert!(matches!(compact::unpack(&damaged, name), Err(SceneError::Checksum { .. })));
    let mut newer = bytes.clone();
    newer[8] = 9;
    let error = compact::unpack(&newer, name).unwrap_err();
    assert!(error.to_string().contains("version 9"), "{error}");
    for length in [0, 5, 20, 30, bytes.len() - 1] {
        assert!(
            matches!(compact::unpack(&bytes[..length], name), Err(SceneError::Malformed { .. })),
            "{length}"
        );
    }
}

fn deposited(field: &SprayField) -> (f64, f64) {
    let volume = field.grid.cell_volume_m3();
    let droplets: f64 = field.deposit_per_m3.iter().map(|&n| f64::from(n) * volume).sum();
    (droplets, field.gas.iter().map(|g| g.vapour_mol_m3 * volume).sum())
}

fn well_formed(field: &SprayField) {
    assert!(field.cells.windows(2).all(|w| w[0] < w[1]));
    assert!((field.cells.last().copied().unwrap_or(0) as usize) < field.grid.len());
    assert_eq!((field.gas.len(), field.deposit_start.len()), (field.cells.len(), field.cells.len() + 1));
    assert_eq!(field.deposit_start.last().copied().unwrap() as usize, field.deposit_parcel.len());
    assert_eq!(field.deposit_parcel.len(), field.deposit_per_m3.len());
    assert!(field.deposit_parcel.iter().all(|&p| (p as usize) < field.parcels.len()));
    assert!(field.gas.iter().all(|g| g.temperature_k.is_finite() && g.vapour_mol_m3 >= 0.0));
}

#[test]
fn nothing_is_lost_on_the_grid_and_the_picture_is_no_speckle() {
    let spray = compact::shipped().unwrap();
    let (field, report) = deposit::field(&spray, &DepositOptions::default()).unwrap();
    well_formed(&field);
    assert!(report.droplet_error < 1e-12 && report.vapour_error < 1e-12, "{report:?}");
    let (droplets, vapour_mol) = deposited(&field);
    assert!(
        (droplets / report.droplets - 1.0).abs() < 1e-6,
        "{droplets}: beyond rounding to single precision"
    );
    assert!((vapour_mol / report.vapour_mol - 1.0).abs() < 1e-12);
    // All droplets but those of the three junk parcels, 1e-7 of the area.
    assert!((report.junk_parcels, report.outside_parcels) == (3, 0) && report.junk_area_share < 1e-6);
    let total = 6.682263526262232e-6 / spray.fuel_molar_mass_kg_mol;
    assert!(((report.vapour_mol + report.outside_vapour_mol) / total - 1.0).abs() < 1e-6);
    assert!(report.n_eff >= 30.0 && report.n_eff_short < 0.01, "{report:?}");
    assert!(report.split_half.iter().all(|&e| e < 0.05), "{:?}", report.split_half);
    // The mean place of droplets and vapour stays (reference.json: centroids), within a tenth of a cell.
    let centre = |cell: u32| {
        let at = field.grid.cell(cell as usize);
        field.grid.lower_m[2] + (at[2] as f64 + 0.5) * field.grid.cell_m()[2]
    };
    let moments: (f64, f64) = field
        .cells
        .iter()
        .zip(&field.gas)
        .fold((0.0, 0.0), |sum, (&c, g)| (sum.0 + centre(c) * g.vapour_mol_m3, sum.1 + g.vapour_mol_m3));
    assert!((moments.0 / moments.1 + 0.020860579441397336).abs() < 1e-4, "{}", moments.0 / moments.1);
}

#[test]
fn junk_neither_fails_nor_shows() {
    let mut spray = compact::shipped().unwrap();
    let (clean, _) = deposit::field(&spray, &DepositOptions::default()).unwrap();
    let parcels = spray.parcels.as_mut().unwrap();
    let junk = |temperature_k: f64, diameter_m: f64, droplets: f64, z: f64| Parcel {
        position_m: [0.0, 0.0, z],
        diameter_m,
        temperature_k,
        droplets,
    };
    parcels.push(junk(200.0, 0.18e-6, 3e3, -0.02));
    parcels.push(junk(5000.0, 0.18e-6, 3e3, -0.02));
    parcels.push(junk(f64::NAN, 1e-5, 1.0, -0.02));
    parcels.push(junk(380.0, 0.0, 1.0, -0.02));
    parcels.push(junk(380.0, 1e-5, 1.0, f64::INFINITY));
    let (field, report) = deposit::field(&spray, &DepositOptions::default()).unwrap();
    assert_eq!(report.junk_parcels, 3 + 5);
    assert_eq!(field, clean);
}

#[test]
fn gas_alone_and_droplets_alone_are_sprays_too() {
    let spray = compact::shipped().unwrap();
    let gas = CfdSpray { parcels: None, liquid_density_kg_m3: None, ..spray.clone() };
    let (field, report) = deposit::field(&gas, &DepositOptions::default()).unwrap();
    well_formed(&field);
    assert!(field.deposit_parcel.is_empty() && report.droplet_cells == 0 && report.vapour_cells > 10_000);

    let liquid = CfdSpray { cells: None, remainder: None, domain_m: None, ..spray.clone() };
    let (field, report) = deposit::field(&liquid, &DepositOptions::default()).unwrap();
    well_formed(&field);
    assert!(report.vapour_cells == 0 && report.droplet_error < 1e-12);
    assert!(field.gas.iter().all(|g| g.vapour_mol_m3 == 0.0));

    let nothing = CfdSpray { parcels: Some(Vec::new()), cells: None, ..spray.clone() };
    assert!(matches!(deposit::field(&nothing, &DepositOptions::default()), Err(SceneError::Deposit { .. })));
    let fine = DepositOptions { cell_m: Some(1e-6), ..DepositOptions::default() };
    assert!(matches!(deposit::field(&spray, &fine), Err(SceneError::Deposit { .. })));
}

#[test]
fn a_region_reports_what_lies_outside() {
    let spray = compact::shipped().unwrap();
    let (whole, all) = deposit::field(&spray, &DepositOptions::default()).unwrap();
    let half =
        DepositOptions { region_m: Some([[0.0, -1.0, -1.0], [1.0, 1.0, 1.0]]), ..DepositOptions::default() };
    let (field, report) = deposit::field(&spray, &half).unwrap();
    well_formed(&field);
    assert!(field.grid.lower_m[0] >= 0.0 && whole.grid.lower_m[0] < -0.01);
    assert!(report.outside_parcels > 5_000 && report.vapour_error < 1e-12);
    assert!(((report.droplets + report.outside_droplets) / all.droplets - 1.0).abs() < 1e-12);
    assert!(report.vapour_mol < 0.6 * all.vapour_mol);
}

#[test]
fn a_spray_may_be_placed_and_turned() {
    let spray = compact::shipped().unwrap();
    let coarse = DepositOptions { cell_m: Some(2e-3), ..DepositOptions::default() };
    let (_, still) = deposit::field(&spray, &coarse).unwrap();
    for (scene_axis, exact) in [([1.0, 0.0, 0.0], true), ([1.0, 0.0, -1.0], false)] {
        let placement = Placement::new(Move {
            tip_m: [0.0, 0.0, -0.0006],
            axis: [0.0, 0.0, -1.0],
            scene_tip_m: [0.1, 0.2, 0.3],
            scene_axis,
            turn_rad: 0.0,
        })
        .unwrap();
        assert_eq!(placement.keeps_boxes(), exact);
        let options = DepositOptions { placement: Some(placement), ..coarse.clone() };
        let (field, report) = deposit::field(&spray, &options).unwrap();
        well_formed(&field);
        assert!(report.droplet_error < 1e-12 && report.vapour_error < 1e-12, "{report:?}");
        assert!((report.droplets / still.droplets - 1.0).abs() < 1e-12);
        assert!((report.vapour_mol / still.vapour_mol - 1.0).abs() < 1e-6);
        // The spray lies on the side of the tip that the axis points to.
        assert!(field.grid.lower_m[0] > 0.06 && field.grid.upper_m[0] > 0.13);
    }
}
