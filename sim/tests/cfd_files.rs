//! Files of sprays as they come: cut off, shared by processors, in other byte orders, with other clouds beside; each
//! must give the same spray or an error that names the file.
//!
//! The sprays are those of `cfd.rs`, or a few cells by hand whose sums are known.

#![expect(clippy::unwrap_used, reason = "helpers of tests may fail loudly too")]

use ditd_sim::scene::field::CfdSpray;
use ditd_sim::scene::import::{self, ImportOptions, SceneError, Time};
use rayon::prelude::*;
use std::io::Read;
use std::path::{Path, PathBuf};

fn sample(form: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cfd/singlehole_5bar_540K").join(form);
    let path = folder.path().join(form);
    unpack(&source, &path);
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

fn copy(source: &Path, target: &Path) {
    std::fs::create_dir_all(target).unwrap();
    for file in files(source) {
        let to = target.join(file.strip_prefix(source).unwrap());
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::copy(file, to).unwrap();
    }
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}

fn attempt(path: &Path) -> Result<CfdSpray, SceneError> {
    import::read(path, Time::Latest, &ImportOptions::default())
}

fn read(path: &Path) -> CfdSpray {
    attempt(path).unwrap()
}

/// The same parcels and cells; density may follow from pressure (1.4e-6), and the liquid's density may be absent.
fn same(one: &CfdSpray, other: &CfdSpray) -> bool {
    let (a, b) = (one.totals(), other.totals());
    let close = |x: Option<f64>, y: Option<f64>, tolerance: f64| match (x, y) {
        (Some(x), Some(y)) => (x - y).abs() <= tolerance * y.abs(),
        (x, y) => x.is_none() && y.is_none(),
    };
    one.parcels == other.parcels
        && a.cells == b.cells
        && close(Some(a.time_s), Some(b.time_s), 1e-12)
        && close(a.gas_volume_m3, b.gas_volume_m3, 1e-12)
        && close(a.vapour_mass_kg, b.vapour_mass_kg, 2e-6)
        && close(a.t_gas_min_k, b.t_gas_min_k, 1e-12)
        && close(a.t_gas_max_k, b.t_gas_max_k, 1e-12)
}

#[test]
fn a_prefix_of_a_file_is_an_error_or_the_same_spray() {
    // Single files of a decomposed case are like those of a whole one: those of one processor will do.
    let forms = ["openfoam", "openfoam_decomposed", "ensight_ascii", "vtk_xml", "vtk_legacy"];
    forms.into_par_iter().for_each(|form| {
        let (_keep, path) = sample(form);
        let whole = read(&path);
        let mut refused = 0;
        for file in files(&path) {
            let name = file.strip_prefix(&path).unwrap().display().to_string();
            if name.starts_with("processor0") || name.starts_with("processor1") {
                continue;
            }
            let bytes = std::fs::read(&file).unwrap();
            let length = bytes.len();
            for cut in [
                0,
                length / 3,
                length * 9 / 10,
                length.saturating_sub(4),
                length.saturating_sub(2),
                length - 1,
            ] {
                std::fs::write(&file, &bytes[..cut]).unwrap();
                match attempt(&path) {
                    Ok(spray) => assert!(same(&spray, &whole), "{form}/{name} cut to {cut} of {length}"),
                    Err(error) => {
                        assert!(error.to_string().len() > 30, "{form}/{name} cut to {cut}: {error}");
                        refused += 1;
                    }
                }
            }
            std::fs::write(&file, &bytes).unwrap();
        }
        assert!(refused > 10, "{form}: {refused}");
        assert!(same(&read(&path), &whole));
    });
}

#[test]
fn garbage_is_refused_by_name_in_every_form() {
    let garbage: Vec<u8> =
        (0..5000_u32).flat_map(|i| (i.wrapping_mul(2_654_435_761) >> 7).to_le_bytes()).collect();
    for (form, name) in [
        ("openfoam", "constant/polyMesh/owner"),
        ("openfoam", "0.0007/T"),
        ("openfoam", "0.0007/lagrangian/sprayCloud/nParticle"),
        ("ensight_ascii", "geometry"),
        ("ensight_ascii", "data/00000000/T"),
        ("ensight_ascii", "data/00000000/lagrangian/sprayCloud/positions"),
        ("vtk_xml", "openfoam_374/internal.vtu"),
        ("vtk_xml", "lagrangian/sprayCloud/sprayCloud_374.vtp"),
        ("vtk_legacy", "openfoam_153.vtk"),
    ] {
        let (_keep, path) = sample(form);
        std::fs::write(path.join(name), &garbage).unwrap();
        let error = attempt(&path).unwrap_err();
        let SceneError::Malformed { file, .. } = &error else { panic!("{form}/{name}: {error}") };
        assert_eq!(file, &path.join(name), "{error}");
    }
}

/// Everything after the header of an OpenFOAM file.
fn body(bytes: &[u8]) -> &[u8] {
    let end = bytes.windows(2).position(|w| w == b"}\n").unwrap();
    &bytes[end + 2..]
}

/// Writes the files of `processors3` (or its parts) from the three folders of a decomposed case.
fn collate(source: &Path, target: &Path, ranks: &[usize]) {
    let mut names: Vec<PathBuf> = Vec::new();
    for rank in 0..3 {
        let folder = source.join(format!("processor{rank}"));
        names.extend(files(&folder).iter().map(|f| f.strip_prefix(&folder).unwrap().to_owned()));
    }
    names.sort();
    names.dedup();
    for name in names.iter().filter(|n| !n.ends_with("uniform/time")) {
        let mut bytes =
            b"FoamFile\n{\n version 2.0;\n format binary;\n class decomposedBlockData;\n}\n// * //\n"
                .to_vec();
        let donor = std::fs::read(source.join("processor2").join(name)).unwrap();
        for (number, rank) in ranks.iter().enumerate() {
            let own = std::fs::read(source.join(format!("processor{rank}")).join(name));
            let block = match (own, number) {
                (Ok(own), 0) => own,
                (Ok(own), _) => body(&own).to_vec(),
                // A processor without parcels: an empty list, or nothing at all.
                (Err(_), 0) => [&donor[..donor.len() - body(&donor).len()], b"\n0()\n"].concat(),
                (Err(_), _) => Vec::new(),
            };
            bytes.extend(format!("\n// Processor{rank}\n\n{}\n(", block.len()).bytes());
            bytes.extend(block);
            bytes.extend(b")\n");
        }
        let file = target.join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, bytes).unwrap();
    }
}

#[test]
fn collated_processors_give_the_same_spray() {
    let (_keep, path) = sample("openfoam_decomposed");
    let apart = read(&path);
    for groups in [vec![vec![0, 1, 2]], vec![vec![0, 1], vec![2]]] {
        let folder = tempfile::tempdir().unwrap();
        let name = |ranks: &[usize]| {
            if groups.len() == 1 {
                "processors3".into()
            } else {
                format!("processors3_{}-{}", ranks[0], ranks[ranks.len() - 1])
            }
        };
        for ranks in &groups {
            collate(&path, &folder.path().join(name(ranks)), ranks);
        }
        assert_eq!(import::list(folder.path()).unwrap(), [0.0007]);
        let together = read(folder.path());
        assert_eq!(together.parcels, apart.parcels);
        assert_eq!(together.cells, apart.cells);
        // A block cut off is noticed.
        let file = folder.path().join(name(&groups[groups.len() - 1])).join("0.0007/T");
        let bytes = std::fs::read(&file).unwrap();
        std::fs::write(&file, &bytes[..bytes.len() - 40]).unwrap();
        let error = attempt(folder.path()).unwrap_err();
        assert!(matches!(&error, SceneError::Malformed { file: named, .. } if *named == file), "{error}");
    }
}

/// A case of one cell of 2 × 3 × 4 mm with one parcel, in binary of any width and byte order.
fn one_cell(folder: &Path, wide_label: bool, single: bool, big_endian: bool, barycentric: bool) {
    let label = |v: i64| -> Vec<u8> {
        let mut bytes = v.to_le_bytes().to_vec();
        bytes.truncate(if wide_label { 8 } else { 4 });
        if big_endian {
            bytes.reverse();
        }
        bytes
    };
    #[expect(clippy::cast_possible_truncation, reason = "that is what the file holds")]
    let scalar = |v: f64| -> Vec<u8> {
        let mut bytes = if single { (v as f32).to_le_bytes().to_vec() } else { v.to_le_bytes().to_vec() };
        if big_endian {
            bytes.reverse();
        }
        bytes
    };
    let write = |name: &str, class: &str, body: Vec<u8>| {
        let file = folder.join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        let arch = format!(
            "\"{};label={};scalar={}\"",
            if big_endian { "MSB" } else { "LSB" },
            if wide_label { 64 } else { 32 },
            if single { 32 } else { 64 }
        );
        let head = format!("FoamFile\n{{\n format binary;\n arch {arch};\n class {class};\n}}\n\n");
        std::fs::write(file, [head.into_bytes(), body].concat()).unwrap();
    };
    let list =
        |count: usize, items: Vec<u8>| [format!("{count}\n(").into_bytes(), items, b")\n".to_vec()].concat();
    let corners: Vec<f64> = (0..8_u8)
        .flat_map(|i| [f64::from(i & 1) * 2e-3, f64::from(i >> 1 & 1) * 3e-3, f64::from(i >> 2) * 4e-3])
        .collect();
    write(
        "constant/polyMesh/points",
        "vectorField",
        list(8, corners.iter().flat_map(|v| scalar(*v)).collect()),
    );
    let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let offsets = list(7, (0..7_i64).flat_map(|i| label(4 * i)).collect());
    let points = list(24, faces.iter().flatten().flat_map(|p| label(*p)).collect());
    write("constant/polyMesh/faces", "faceCompactList", [offsets, points].concat());
    write("constant/polyMesh/owner", "labelList", list(6, (0..6).flat_map(|_| label(0)).collect()));
    write("constant/polyMesh/neighbour", "labelList", b"0\n()\n".to_vec());
    write("1e-3/T", "volScalarField", b"internalField uniform 450;\n".to_vec());
    write("1e-3/rho", "volScalarField", b"internalField uniform 3;\n".to_vec());
    let fraction =
        [b"internalField nonuniform List<scalar> \n".to_vec(), list(1, scalar(0.25)), b";\n".to_vec()]
            .concat();
    write("1e-3/C7H16", "volScalarField", fraction);
    let cloud = "1e-3/lagrangian/sprayCloud";
    let record = if barycentric {
        // Half way between the centre and corner 4 of face 0 (tetrahedron 1: corners 0, 4, 6).
        [scalar(0.5), scalar(0.0), scalar(0.5), scalar(0.0), label(0), label(0), label(1)].concat()
    } else {
        [scalar(0.5e-3), scalar(0.75e-3), scalar(3e-3), label(0)].concat()
    };
    write(&format!("{cloud}/positions"), "Cloud", [b"1\n(\n(".to_vec(), record, b")\n)\n".to_vec()].concat());
    for (name, value) in [("d", 1e-5), ("T", 380.0), ("nParticle", 5e4), ("rho", 600.0)] {
        write(&format!("{cloud}/{name}"), "scalarField", list(1, scalar(value)));
    }
}

#[test]
fn openfoam_binary_is_read_in_every_width_order_and_kind_of_place() {
    for bits in 0..16_u8 {
        let folder = tempfile::tempdir().unwrap();
        let on = |bit: u8| bits >> bit & 1 == 1;
        one_cell(folder.path(), on(0), on(1), on(2), on(3));
        let spray = read(folder.path());
        let totals = spray.totals();
        // Single precision has 24 bits.
        let close = |found: Option<f64>, expected: f64| (found.unwrap() / expected - 1.0).abs() < 4.0 * 6e-8;
        assert!(close(totals.vapour_mass_kg, 24e-9 * 3.0 * 0.25), "{bits:04b}: {totals:?}");
        assert!(close(totals.droplets, 5e4) && close(totals.d32_um, 10.0), "{bits:04b}: {totals:?}");
        assert!(close(totals.liquid_mass_kg, 5e4 * 600.0 * std::f64::consts::PI / 6.0 * 1e-15), "{bits:04b}");
        let place = spray.parcels.unwrap()[0].position_m;
        for (found, expected) in place.iter().zip([0.5e-3, 0.75e-3, 3e-3]) {
            assert!((found - expected).abs() < 1e-9, "{bits:04b}: {place:?}");
        }
    }
}

/// An EnSight case of one cell and two particles, C or Fortran binary.
fn ensight(folder: &Path, fortran: bool, big_endian: bool) {
    let int = |v: i32| if big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
    let float = |v: f32| if big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
    let text = |t: &str| t.bytes().chain(std::iter::repeat(0)).take(80).collect::<Vec<u8>>();
    let write = |name: &str, records: Vec<Vec<u8>>| {
        let mut bytes = Vec::new();
        for record in records {
            let mark = int(i32::try_from(record.len()).unwrap());
            if fortran {
                bytes.extend(mark);
            }
            bytes.extend(record);
            if fortran {
                bytes.extend(mark);
            }
        }
        std::fs::write(folder.join(name), bytes).unwrap();
    };
    let floats = |v: &[f32]| v.iter().flat_map(|v| float(*v)).collect::<Vec<u8>>();
    let ints = |v: &[i32]| v.iter().flat_map(|v| int(*v)).collect::<Vec<u8>>();
    let kind = if fortran { "Fortran Binary" } else { "C Binary" };
    let mut geometry: Vec<Vec<u8>> =
        [kind, "geometry", "by hand", "node id assign", "element id assign", "part"].map(text).into();
    geometry.extend([ints(&[1]), text("mesh"), text("coordinates"), ints(&[8])]);
    geometry.push(floats(&[0., 1., 1., 0., 0., 1., 1., 0.]));
    geometry.push(floats(&[0., 0., 2., 2., 0., 0., 2., 2.]));
    geometry.push(floats(&[0., 0., 0., 0., 3., 3., 3., 3.]));
    geometry.extend([text("hexa8"), ints(&[1]), ints(&[1, 2, 3, 4, 5, 6, 7, 8])]);
    write("geo", geometry);
    for (name, value) in [("gasT", 450.0), ("gasRho", 2.0), ("fuel", 0.25)] {
        write(name, vec![text(name), text("part"), ints(&[1]), text("hexa8"), floats(&[value])]);
    }
    let places = floats(&[0.5, 0.5, 0.5, 0.25, 1.5, 2.5]);
    write(
        "places",
        vec![text(kind), text("by hand"), text("particle coordinates"), ints(&[2]), ints(&[1, 2]), places],
    );
    for (name, values) in [("d", [1e-5, 2e-5]), ("dropT", [380.0, 390.0]), ("n", [100.0, 300.0])] {
        write(name, vec![text(name), floats(&values)]);
    }
    let case = "FORMAT\ntype: ensight gold\nGEOMETRY\nmodel: geo\nmeasured: places\nVARIABLE\n\
                scalar per element: T gasT\nscalar per element: rho gasRho\nscalar per element: C7H16 fuel\n\
                scalar per measured node: c0d d\nscalar per measured node: c0T dropT\n\
                scalar per measured node: c0nParticle n\n";
    std::fs::write(folder.join("x.case"), case).unwrap();
}

#[test]
fn ensight_particles_are_read_from_c_and_fortran_in_both_byte_orders() {
    for (fortran, big_endian) in [(false, false), (false, true), (true, false), (true, true)] {
        let folder = tempfile::tempdir().unwrap();
        ensight(folder.path(), fortran, big_endian);
        let spray = read(folder.path());
        let totals = spray.totals();
        let what = format!("fortran {fortran}, big-endian {big_endian}");
        assert_eq!((totals.parcels, totals.droplets), (Some(2), Some(400.0)), "{what}");
        assert_eq!(totals.vapour_mass_kg, Some(6.0 * 2.0 * 0.25), "{what}");
        assert!((totals.d_max_um.unwrap() - 20.0).abs() < 1e-5, "{what}");
        let place = spray.parcels.unwrap()[1].position_m;
        assert!(place.iter().zip([0.25, 1.5, 2.5]).all(|(a, b)| (a - b).abs() < 1e-15), "{what}: {place:?}");
        if fortran {
            let file = folder.path().join("dropT");
            let bytes = std::fs::read(&file).unwrap();
            std::fs::write(&file, &bytes[..bytes.len() - 4]).unwrap();
            let error = attempt(folder.path()).unwrap_err();
            assert!(matches!(&error, SceneError::Malformed { file: named, .. } if *named == file), "{error}");
        }
    }
}

#[test]
fn legacy_vtk_of_newer_programs_is_read_in_text() {
    let folder = tempfile::tempdir().unwrap();
    let meta = "METADATA\nINFORMATION 1\nNAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 0 1 \n\n";
    let grid = format!(
        "# vtk DataFile Version 5.1\nby hand\nASCII\nDATASET UNSTRUCTURED_GRID\nFIELD FieldData 1\nTimeValue 1 1 float\n\
         0.0007 \n{meta}POINTS 8 float\n0 0 0 1 0 0 1 2 0 \n0 2 0 0 0 3 1 0 3 \n1 2 3 0 2 3 \n{meta}CELLS 2 8\n\
         OFFSETS vtktypeint64\n0 8 \nCONNECTIVITY vtktypeint64\n0 1 2 3 4 5 6 7 \n\nCELL_TYPES 1\n12\n\nCELL_DATA 1\n\
         FIELD FieldData 2\nT 1 1 float\n450 \n{meta}rho 1 1 float\n2 \n{meta}SCALARS C7H16 float\nLOOKUP_TABLE default\n0.25 \n{meta}"
    );
    let cloud = format!(
        "# vtk DataFile Version 5.1\nby hand\nASCII\nDATASET POLYDATA\nFIELD FieldData 1\nTimeValue 1 1 float\n0.0007 \n\
         POINTS 2 float\n0.5 0.5 0.5 0.25 1.5 2.5 \nVERTICES 3 2\nOFFSETS vtktypeint64\n0 1 2 \nCONNECTIVITY vtktypeint64\n\
         0 1 \nPOINT_DATA 2\nSCALARS d float 1\nLOOKUP_TABLE default\n1e-5 2e-5 \nVECTORS U float\n1 2 3 4 5 6 \n\
         FIELD FieldData 2\nT 1 2 float\n380 390 \n{meta}nParticle 1 2 float\n100 300 \n"
    );
    std::fs::write(folder.path().join("mesh_0.vtk"), &grid).unwrap();
    for name in ["cloud_0.vtk", "z_0.vtk"] {
        let file = folder.path().join(name);
        std::fs::write(&file, &cloud).unwrap();
        assert_eq!(import::list(folder.path()).unwrap(), [0.0007]);
        let totals = read(folder.path()).totals();
        assert_eq!((totals.droplets, totals.vapour_mass_kg), (Some(400.0), Some(6.0 * 2.0 * 0.25)), "{name}");
        // The last number may not lose digits.
        std::fs::write(&file, &cloud[..cloud.len() - 3]).unwrap();
        assert!(matches!(attempt(folder.path()), Err(SceneError::Malformed { .. })));
        std::fs::remove_file(file).unwrap();
    }
}

#[test]
fn a_table_may_say_how_many_rows_it_has() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("parcels.csv");
    let table = "# time_s = 0.001\n# rows = 2\nx_mm,y_mm,z_m,d_um,T_K,nParticle\n1,2,0.003,10,380,5\n1,2,0.004,20,390,7\n";
    std::fs::write(&file, table).unwrap();
    let spray = read(folder.path());
    assert_eq!(spray.totals().droplets, Some(12.0));
    assert!((spray.parcels.unwrap()[1].position_m[2] - 0.004).abs() < 1e-18 && spray.notes.is_empty());
    let cut = &table[..table.len() - "1,2,0.004,20,390,7\n".len()];
    std::fs::write(&file, cut).unwrap();
    assert!(matches!(attempt(folder.path()), Err(SceneError::Length { expected: 2, found: 1, .. })));
    std::fs::write(&file, cut.replace("# rows = 2\n", "").trim_end()).unwrap();
    assert!(read(folder.path()).notes.iter().any(|n| n.contains("cut off")));
    std::fs::write(&file, table.replace("z_m", "x_m")).unwrap();
    assert!(attempt(folder.path()).unwrap_err().to_string().contains("twice"));
    std::fs::write(&file, table.replace("0.001\n", "soon\n")).unwrap();
    assert!(matches!(attempt(folder.path()), Err(SceneError::Malformed { .. })));
}

#[test]
fn several_clouds_and_fuels_are_told_apart_and_said() {
    let (_keep, path) = sample("openfoam");
    let one = read(&path).totals();
    assert!(read(&path).notes.is_empty());
    let lagrangian = path.join("0.0007/lagrangian");
    // Tracers without droplets' lists are nothing to us.
    std::fs::create_dir(lagrangian.join("tracers")).unwrap();
    std::fs::copy(lagrangian.join("sprayCloud/positions"), lagrangian.join("tracers/positions")).unwrap();
    let spray = read(&path);
    assert_eq!(spray.totals().parcels, one.parcels);
    assert!(
        spray.notes.iter().any(|n| n.contains("tracers") && n.contains("nParticle")),
        "{:?}",
        spray.notes
    );
    copy(&lagrangian.join("sprayCloud"), &lagrangian.join("second"));
    let spray = read(&path);
    assert_eq!(spray.totals().parcels.unwrap(), 2 * one.parcels.unwrap());
    assert!(spray.notes.iter().any(|n| n.contains("second, sprayCloud")), "{:?}", spray.notes);
    // Two fuels in the gas, one in the droplets.
    std::fs::copy(path.join("0.0007/C7H16"), path.join("0.0007/C8H18")).unwrap();
    let spray = read(&path);
    assert_eq!(spray.fuel, "C7H16");
    assert!(spray.notes.iter().any(|n| n.contains("C8H18")), "{:?}", spray.notes);
    for cloud in ["sprayCloud", "second"] {
        std::fs::remove_file(lagrangian.join(cloud).join("YC7H16(l)")).unwrap();
    }
    let error = attempt(&path).unwrap_err();
    assert!(error.to_string().contains("C7H16, C8H18"), "{error}");
    let named = ImportOptions { fuel: Some("C8H18".into()), ..ImportOptions::default() };
    assert_eq!(import::read(&path, Time::Latest, &named).unwrap().fuel, "C8H18");
}

#[test]
fn a_few_senseless_parcels_are_said_and_many_are_refused() {
    let (_keep, path) = sample("openfoam");
    let whole = read(&path).totals();
    let write = |name: &str, value: &dyn Fn(usize) -> f64| {
        let values: Vec<String> = (0..7975).map(|i| value(i).to_string()).collect();
        let head = "FoamFile { version 2.0; format ascii; class scalarField; }\n";
        let file = path.join("0.0007/lagrangian/sprayCloud").join(name);
        std::fs::write(file, format!("{head}7975({})\n", values.join("\n"))).unwrap();
    };
    write("T", &|i| if i == 9 { f64::NAN } else { 380.0 });
    write("nParticle", &|i| if i == 17 { -1e9 } else { 50.0 });
    let spray = read(&path);
    assert!(spray.notes.iter().any(|n| n.starts_with("2 parcels")), "{:?}", spray.notes);
    let totals = spray.totals();
    assert_eq!((totals.parcels, totals.droplets), (whole.parcels, Some(50.0 * 7973.0)));
    assert!((totals.t_liquid_mean_k.unwrap() - 380.0).abs() < 1e-9 && totals.n_eff.unwrap() > 1.0);
    for nonsense in [f64::NAN, -5.0, f64::INFINITY] {
        write("nParticle", &|i| if i % 50 == 0 { nonsense } else { 50.0 });
        let error = attempt(&path).unwrap_err();
        assert!(
            matches!(error, SceneError::Malformed { .. }) && error.to_string().contains("161 of 7975"),
            "{error}"
        );
    }
}

#[test]
fn the_wrong_time_names_the_nearest_and_wide_sprays_ask_for_their_unit() {
    let (_keep, path) = sample("openfoam");
    let error = import::read(&path, Time::At(0.00072), &ImportOptions::default()).unwrap_err();
    assert!(error.to_string().contains("nearest is 0.0007 s"), "{error}");
    assert!(import::read(&path, Time::At(0.000_700_001), &ImportOptions::default()).is_ok());
    let metres = ImportOptions { length_unit_m: 1e3, ..ImportOptions::default() };
    let notes = import::read(&path, Time::Latest, &metres).unwrap().notes;
    assert!(notes.iter().any(|n| n.contains("millimetres")), "{notes:?}");
}
