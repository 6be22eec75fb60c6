//! Fuels and windows of the user's own, as scene files and simulated rigs name them: the same tables give the same bits
//! as shipped ones, and every mistake is named with its file and row.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

use ditd_sim::light::fuel::LIQUID_REFERENCE_K;
use ditd_sim::scene::file::{MediumSource, Scene, SceneError, load};
use ditd_sim::scene::library;
use ditd_sim::scene::optics::OpticsOptions;
use std::path::Path;

const FRAME: &str = "[camera]\nkind = \"pinhole\"\nposition_m = [0.0, -0.6, 0.0]\nlook_at_m = [0.0, 0.0, 0.0]\n\
    up = [0.0, 0.0, 1.0]\ncolumns = 8\nrows = 6\nhorizontal_fov_deg = 10.0\npixel_filter = \"centre\"\n\
    [plate]\nshape = \"rectangle\"\ncentre_m = [0.0, 0.3, 0.0]\nfacing = [0.0, -1.0, 0.0]\nwidth_m = 1.0\n\
    height_m = 1.0\ntemperature_k = 433.0\nemissivity = 0.95\n[walls]\ntemperature_k = 523.0\nemissivity = 0.9\n\
    [band]\nwavelength_um = 3.42\n[lab]\ntemperature_k = 296.0\n";

fn window(material: &str) -> String {
    format!(
        "[[window]]\nmaterial = \"{material}\"\nthickness_m = 0.01\ntemperature_k = 400.0\nposition_m = [0.0, -0.1, 0.0]\n\
         normal = [0.0, 1.0, 0.0]\ndiameter_m = 0.5\n"
    )
}

fn spray(fuel: &str) -> String {
    format!(
        "[medium]\nkind = \"cfd\"\npath = \"eighthole_4bar_523K_0.9ms\"\nfuel = \"{fuel}\"\ncell_m = 0.002\n"
    )
}

fn data(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("data/optics").join(name)).unwrap()
}

/// A folder with a scene that has these files beside it.
fn scene(text: &str, files: &[(&str, &str)]) -> Result<Scene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    for (name, content) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, content).unwrap();
    }
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, text).unwrap();
    load(&path)?.with_spray(&OpticsOptions::default())
}

#[test]
fn a_window_of_the_users_own_table_is_that_table() {
    let own = scene(
        &format!("{FRAME}{}", window("glass/mine.csv")),
        &[("glass/mine.csv", &data("window_CaF2.csv"))],
    );
    let near = own.unwrap().windows.near.unwrap();
    let shipped = scene(&format!("{FRAME}{}", window("CaF2")), &[]).unwrap().windows.near.unwrap();
    assert_eq!(near.plate.material.table().name(), "mine");
    for um in [2.4, 2.512, 3.42, 5.99, 7.0] {
        assert_eq!(near.plate.optics(um, 400.0), shipped.plate.optics(um, 400.0), "{um} um");
    }
}

#[test]
fn a_fuel_of_the_users_own_tables_is_those_tables() {
    // n-octane's tables and the density that it is shipped with.
    let own = "liquid = \"tables/l.csv\"\nvapour = \"tables/v.csv\"\nmolar_mass_kg_mol = 0.11422852\n\
               density = { kg_m3 = 698.6, at_k = 298.15, critical_k = 568.7, compressibility = 0.2571 }\n";
    let (l, v) = (data("liquid_n-octane_nk_measured.csv"), data("vapour_n-octane_xsec_model.csv"));
    let files = [("mine.toml", own), ("tables/l.csv", l.as_str()), ("tables/v.csv", v.as_str())];
    let coefficients = |fuel: &str| {
        let scene = scene(&format!("{FRAME}{}", spray(fuel)), &files).unwrap();
        let Some(MediumSource::Spectral(grid, _)) = scene.medium else { panic!("a spectral grid") };
        let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert!(grid.k_ext.iter().any(|k| *k > 1.0));
        (bits(&grid.k_ext), bits(&grid.k_sca), bits(&grid.emission))
    };
    let own = coefficients("mine.toml");
    assert!(own == coefficients("n-octane"));
    assert!(own != coefficients("toluene"));
}

#[test]
fn a_band_beyond_the_liquids_table_is_said_in_the_notes() {
    let own =
        "liquid = \"l.csv\"\nvapour = \"v.csv\"\nmolar_mass_kg_mol = 0.1\ndensity = { file = \"d.csv\" }\n";
    let files = [
        ("mine.toml", own),
        ("l.csv", "wavelength_um,n,k\n3.5,1.4,0.1\n4,1.4,0.1\n"),
        ("v.csv", "wavelength_um,sigma_m2_mol_300K\n3,1\n4,1\n"),
        ("d.csv", "T_K,rho_liq_kg_m3\n280,700\n400,600\n"),
    ];
    let scene = scene(&format!("{FRAME}{}", spray("mine.toml")), &files).unwrap();
    assert!(scene.notes.iter().any(|note| note.contains("1 of 1 wavelengths")), "{:?}", scene.notes);
}

#[test]
fn mistakes_name_the_scenes_line_the_file_and_its_row() {
    let message = |text: &str, files: &[(&str, &str)]| scene(text, files).unwrap_err().to_string();
    let line = |text: &str, start: &str| text.lines().position(|l| l.starts_with(start)).unwrap() + 1;
    let text = format!("{FRAME}{}", window("mine.csv"));
    let found = message(&text, &[("mine.csv", "wavelength_um,n\n3,1.5\n4,x\n")]);
    assert!(found.contains(&format!("line {}", line(&text, "material"))), "{found}");
    assert!(found.contains("mine.csv: row 2 (line 3), column `n`: `x` is not a number"), "{found}");
    assert!(message(&text, &[]).contains("mine.csv: reading the file"));
    let found = message(&format!("{FRAME}{}", window("sapphir")), &[]);
    assert!(found.contains("did you mean `sapphire`?") && found.contains("ends in .csv"), "{found}");

    let text = format!("{FRAME}{}", spray("mine.toml"));
    let found = message(&text, &[("mine.toml", "[[part]]\nfuel = \"etanol\"\nvolume_fraction = 1\n")]);
    assert!(found.contains(&format!("line {}", line(&text, "fuel"))), "{found}");
    assert!(
        found.contains("mine.toml: [[part]] fuel `etanol` is not known (did you mean `ethanol`?)"),
        "{found}"
    );
    let found = message(&format!("{FRAME}{}", spray("n-heptan")), &[]);
    assert!(found.contains("did you mean `n-heptane`?") && found.contains("ends in .toml"), "{found}");
}

#[test]
fn a_blend_lies_between_its_parts() {
    let folder = tempfile::tempdir().unwrap();
    for share in [0.25, 0.75] {
        let text = format!(
            "[[part]]\nfuel = \"ethanol\"\nvolume_fraction = {share}\n[[part]]\nfuel = \"isooctane\"\nvolume_fraction = {}\n",
            1.0 - share
        );
        std::fs::write(folder.path().join("blend.toml"), text).unwrap();
        let blend = library::fuel("blend.toml", folder.path()).unwrap();
        let [a, b] = ["ethanol", "isooctane"].map(|name| library::fuel(name, folder.path()).unwrap());
        // Volumes add up at the reference temperature, so densities do by volume.
        let density = |fuel: &ditd_sim::light::fuel::Fuel| fuel.liquid_density(LIQUID_REFERENCE_K);
        let wanted = share * density(&a) + (1.0 - share) * density(&b);
        assert!((density(&blend) / wanted - 1.0).abs() < 1e-12);
        // Vapour per mole: mole fractions from the volumes.
        let moles = [(share, &a), (1.0 - share, &b)].map(|(v, f)| v * density(f) / f.molar_mass_kg_mol());
        let x = moles[0] / (moles[0] + moles[1]);
        let section = |fuel: &ditd_sim::light::fuel::Fuel| fuel.vapour_cross_section_m2_mol(3.4, 420.0);
        let wanted = x * section(&a) + (1.0 - x) * section(&b);
        // Between rows 1 cm-1 apart a mixture is straight where its parts are.
        assert!((section(&blend) / wanted - 1.0).abs() < 1e-9, "{} {wanted}", section(&blend));
    }
}
