//! Campaign files: every shipped one loads, every mistake is named with its line, and nothing impossible passes.

use ditd::config::Config;
use std::path::Path;

fn quickstart() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/quickstart.toml"))
        .expect("the quickstart is shipped")
}

fn refusal(text: &str) -> String {
    Config::parse("x.toml", text).expect_err("this must be refused").to_string()
}

/// The quickstart with one line replaced.
fn with(line_start: &str, replacement: &str) -> String {
    let text = quickstart();
    let found = text.lines().filter(|line| line.trim_start().starts_with(line_start)).count();
    assert!(found >= 1, "the quickstart has no line {line_start:?}");
    let mut done = false;
    let lines: Vec<String> = text
        .lines()
        .map(|line| {
            if !done && line.trim_start().starts_with(line_start) {
                done = true;
                replacement.to_owned()
            } else {
                line.to_owned()
            }
        })
        .collect();
    lines.join("\n")
}

#[test]
fn every_shipped_campaign_and_scene_file_loads() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
    let (mut campaigns, mut scenes) = (0, 0);
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "toml") {
            let text = std::fs::read_to_string(&path).unwrap();
            if text.contains("[campaign]") {
                Config::parse(&path.display().to_string(), &text).unwrap_or_else(|error| panic!("{error}"));
                campaigns += 1;
            } else {
                ditd_sim::scene::file::load(&path).unwrap_or_else(|error| panic!("{error}"));
                scenes += 1;
            }
        }
    }
    assert!(campaigns >= 2 && scenes >= 2, "found {campaigns} campaign files and {scenes} scenes");
}

/// The rig takes the parametric spray of a scene file, and keeps that file with the run.
#[test]
fn the_rig_takes_the_spray_of_a_scene_file() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("spray.toml"),
        "[medium]\nkind = \"multi-hole\"\nfuel = \"n-heptane\"\n",
    )
    .unwrap();
    let text = with("source = { embedded", "source = { scene = \"spray.toml\" }");
    let config = Config::parse("x.toml", &text).unwrap();
    let files = ditd::rigs::own_files(&config, folder.path()).unwrap();
    assert_eq!(files.len(), 1);
    assert_eq!(files[0].0, Path::new("spray.toml"));
    let mut rig = config.rig.clone().unwrap();
    rig.view.columns = 40;
    rig.view.rows = 32;
    rig.target_error = 0.05;
    let spray = rig.spray.as_mut().unwrap();
    spray.cell_m = 0.002;
    spray.scales = vec![1.0];
    rig.fluctuation = None;
    let world = ditd_sim::rig::build::world(&rig, ditd::rigs::View::Chamber, 1, folder.path(), &|_, _| {});
    assert!(world.is_ok(), "{:?}", world.err());
    // Another fuel than the campaign's, a scene without such a spray, and no scene at all.
    for (content, words) in [
        ("[medium]\nkind = \"multi-hole\"\nfuel = \"toluene\"\n", "toluene"),
        ("[walls]\ntemperature_k = 300\n", "multi-hole"),
        ("[medium]\nkind = \"multi-hole\"\nfuel = \"n-heptane\"\ntime_s = -1\n", "time_s is -1"),
    ] {
        std::fs::write(folder.path().join("spray.toml"), content).unwrap();
        let error = ditd::rigs::own_files(&config, folder.path()).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("spray.toml"), "{error}");
    }
}

#[test]
fn an_unknown_key_is_named_with_line_caret_allowed_keys_and_a_guess() {
    let text = with("band_k", "bandk = 0.3");
    let message = refusal(&text);
    let line = text.lines().position(|line| line.starts_with("bandk")).unwrap() + 1;
    assert!(message.starts_with(&format!("x.toml:{line}:1: unknown key `bandk`")), "{message}");
    assert!(message.contains("^^^^^"), "{message}");
    assert!(message.contains("allowed here: band_k, hold_s"), "{message}");
    assert!(message.contains("did you mean `band_k`?"), "{message}");
}

#[test]
fn an_unknown_table_is_refused() {
    let message = refusal(&format!("{}\n[sook]\nband_k = 1.0\n", quickstart()));
    assert!(message.contains("unknown key `sook`") && message.contains("did you mean `soak`?"), "{message}");
}

#[test]
fn a_missing_physical_quantity_is_refused() {
    let message = refusal(&with("gamma_near", "# gone"));
    assert!(message.contains("missing field `gamma_near`"), "{message}");
}

#[test]
fn a_newer_schema_is_refused_by_its_version() {
    let message = refusal(&with("schema = 1", "schema = 7"));
    assert!(message.contains("schema 7 is newer") && message.contains("x.toml:"), "{message}");
}

#[test]
fn limits_and_impossible_combinations_are_refused_with_their_key() {
    for (line, replacement, key) in [
        ("levels_k = [373", "levels_k = [373.0, 900.0]", "campaign.levels_k"),
        ("levels_k = [373", "levels_k = [373.0, 373.0]", "campaign.levels_k"),
        ("levels_k = [373", "levels_k = [100.0, 130.0]", "campaign.levels_k"),
        ("pause_s", "pause_s = 2.0", "campaign.pause_s"),
        ("blanks = ", "blanks = 0", "campaign.blanks"),
        ("frame_period_s", "frame_period_s = 0.001", "campaign.frame_period_s"),
        ("injection_s", "injection_s = 0.1", "trigger.injection_s"),
        ("gamma_near", "gamma_near = 1.2", "optics.gamma_near"),
        ("emissivity_plate", "emissivity_plate = 0.0", "optics.emissivity_plate"),
        ("estimator", "estimator = \"mine\"", "fit.estimator"),
        ("saturation_count", "saturation_count = 20000", "camera.saturation_count"),
        ("limit_k", "limit_k = 500.0", "campaign.levels_k"),
        ("hold_s", "hold_s = 1.0", "soak.hold_s"),
        ("poll_s", "poll_s = 61.0", "soak.poll_s"),
        ("epoch", "epoch = \"yesterday\"", "campaign.epoch"),
    ] {
        let message = refusal(&with(line, replacement));
        assert!(message.contains(&format!("`{key}`")), "{replacement}: {message}");
        assert!(message.contains("x.toml:"), "{replacement}: no place in {message}");
    }
}

/// What the trigger unit's driver would refuse before it sends anything is refused here too, by the same questions.
#[test]
fn what_may_not_be_triggered_is_refused_in_the_plan() {
    for (line, replacement, key, words) in [
        // Exposure and read-out overlap the next frame.
        ("readout_s", "readout_s = 0.02", "campaign.frame_period_s", "overlap"),
        ("integration_s", "integration_s = 0.019", "trigger.exposure_delay_s", "before the next clock pulse"),
        // The injector is held open for longer than it may, or into the next period.
        ("injection_s", "injection_s = 0.0051", "trigger.injection_s", "injection_limit_s"),
        ("injection_limit_s", "injection_limit_s = 0.0009", "trigger.injection_s", "injection_limit_s"),
        (
            "injection_s",
            "injection_s = 0.020\ninjection_limit_s = 1.0",
            "trigger.injection_s",
            "within one period",
        ),
        // Shots nearer than the chamber allows.
        ("pause_s", "pause_s = 14.7", "campaign.pause_s", "injections"),
        // The camera's pulse in the next period, or before its own.
        ("exposure_delay_s", "exposure_delay_s = 0.0199", "trigger.exposure_delay_s", "before the next"),
        ("exposure_delay_s", "exposure_delay_s = -0.001", "trigger.exposure_delay_s", "before the next"),
        // Nothing, or less.
        ("injection_s", "injection_s = 0.0", "trigger.injection_s", "positive"),
        ("injection_s", "injection_s = -0.001", "trigger.injection_s", "positive"),
        ("injection_s", "injection_s = nan", "trigger.injection_s", "positive"),
        ("injection_s", "injection_s = 4e-9", "trigger.injection_s", "10 ns at least"),
        ("integration_s", "integration_s = 4e-9", "trigger.exposure_delay_s", "10 ns at least"),
        ("integration_s", "integration_s = 0.0", "camera.integration_s", "positive"),
        // More than the unit counts, and more than anyone would wait for.
        ("cycles = ", "cycles = 20000", "campaign.cycles", "counts from 1 to 9999999"),
        ("cycles = ", "cycles = 4000000000", "campaign.cycles", "4·10⁹"),
        ("cycles = ", "cycles = 0", "campaign.cycles", "at least one"),
        ("driver = \"quantum_9520\"", "driver = \"quantum_9250\"", "trigger.driver", "quantum_9520, dg645"),
    ] {
        let text = with(line, replacement);
        // A key that a replacement brings along must not be there twice.
        let text = if replacement.contains('\n') {
            let (once, _) = text.split_once("injection_limit_s = 0.005").unwrap();
            format!("{once}{}", &text[once.len() + "injection_limit_s = 0.005".len()..])
        } else {
            text
        };
        let message = refusal(&text);
        assert!(message.contains(&format!("`{key}`")), "{replacement}: {message}");
        assert!(message.contains(words), "{replacement}: {message}");
    }
}

/// The other unit has its own range: it counts the frames of a cycle only, but its period ends at 42.9 s.
#[test]
fn each_trigger_unit_has_its_own_range() {
    let unit = "driver = \"quantum_9520\"";
    let dg645 = |text: &str| text.replace(unit, "driver = \"dg645\"");
    Config::parse("x.toml", &dg645(&quickstart())).unwrap();
    Config::parse("x.toml", &dg645(&with("cycles = ", "cycles = 20000"))).unwrap();
    let slow = with("frame_period_s", "frame_period_s = 43.0");
    Config::parse("x.toml", &slow).unwrap();
    let message = refusal(&dg645(&slow));
    assert!(message.contains("`campaign.frame_period_s`") && message.contains("42.9 s"), "{message}");
}

/// What no source says of a real DG645 somebody must have seen.
#[test]
fn a_real_delay_generator_must_have_been_looked_at() {
    let real = "driver = \"dg645\"\naddress = \"tcp:10.0.0.7:5025\"";
    let text = quickstart().replace("driver = \"quantum_9520\"\naddress = \"sim\"", real);
    assert!(text.contains(real));
    let message = refusal(&text);
    assert!(message.contains("prescaler_checked") && message.contains("oscilloscope"), "{message}");
    Config::parse("x.toml", &text.replace(real, &format!("{real}\nprescaler_checked = true"))).unwrap();
}

#[test]
fn check_draws_the_pulses_it_would_program() {
    let folder = tempfile::tempdir().unwrap();
    let check = |file: &str| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_ditd"));
        command.args(["check", "quickstart", "--timing", file]).current_dir(folder.path()).output().unwrap()
    };
    let output = check("pulses.svg");
    assert!(output.status.success(), "{output:?}");
    let svg = std::fs::read_to_string(folder.path().join("pulses.svg")).unwrap();
    for words in [">blank 4<", ">spray<", ">pause 15 s<", ">injection 1 ms<", ">exposure 25 µs<"] {
        assert!(svg.contains(words), "{words}");
    }
    let shown = include_str!("../docs/images/timing.svg");
    assert_eq!(svg, shown, "the drawing in the docs is the quickstart's");
    let output = check("pulses.png");
    assert_eq!(output.status.code(), Some(2), "{output:?}");
}

#[test]
fn every_unknown_key_is_refused_in_every_table() {
    let text = quickstart();
    for (index, line) in text.lines().enumerate() {
        let is_key = line.contains('=') && !line.trim_start().starts_with(['#', '[']) && !line.contains("[[");
        let top_level_array_item = line.trim_start().starts_with('{');
        if !is_key || top_level_array_item {
            continue;
        }
        let lines: Vec<String> = text
            .lines()
            .enumerate()
            .map(|(i, l)| if i == index { format!("zz_{}", l.trim_start()) } else { l.to_owned() })
            .collect();
        let message = refusal(&lines.join("\n"));
        assert!(message.contains("zz_"), "line {}: {message}", index + 1);
    }
}

#[test]
fn fuels_and_windows_of_your_own_are_checked_with_file_and_row() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        std::fs::create_dir_all(folder.path().join("mine")).unwrap();
        std::fs::write(folder.path().join("mine").join(name), text).unwrap();
    };
    let files = |text: &str| {
        let config = Config::parse("x.toml", text).unwrap_or_else(|error| panic!("{error}"));
        ditd::rigs::own_files(&config, folder.path())
    };
    assert!(files(&quickstart()).unwrap().is_empty());
    // The file itself is read when the rig is built, not with the campaign file.
    let fuel = with("fuel = ", "fuel = \"mine/e85.toml\"");
    assert!(files(&fuel).unwrap_err().to_string().contains("e85.toml: reading the file"));
    let part = |name: &str, share: f64| format!("[[part]]\nfuel = \"{name}\"\nvolume_fraction = {share}\n");
    write("e85.toml", &format!("{}{}", part("ethanol", 0.85), part("isooctane", 0.15)));
    let found = files(&fuel).unwrap();
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].0, Path::new("mine/e85.toml"));
    write("e85.toml", &part("ethanol", 0.85));
    let error = files(&fuel).unwrap_err();
    assert_eq!(error.code(), 2);
    assert!(error.to_string().contains("sum of the volume fractions"), "{error}");

    let glass = "near = { material = \"mine/glass.csv\", thickness_m = 0.01, temperature_k = 450.0 }";
    let window = with("near = ", glass);
    write("glass.csv", "wavelength_um,n,k\n3,1.5,0\n4,1.5,-1\n");
    let error = files(&window).unwrap_err().to_string();
    assert!(error.contains("glass.csv: row 2 (line 3), column `k`: -1 is not possible"), "{error}");
    write("glass.csv", "wavelength_um,n\n3,1.5\n4,1.5\n");
    assert_eq!(files(&window).unwrap().len(), 1);

    let message = refusal(&with("near = ", &glass.replace("mine/glass.csv", "sapphir")));
    assert!(
        message.contains("`rig.window.near`") && message.contains("did you mean `sapphire`?"),
        "{message}"
    );
    let message = refusal(&with("fuel = ", "fuel = \"n-heptan\""));
    assert!(
        message.contains("`rig.spray.fuel`") && message.contains("did you mean `n-heptane`?"),
        "{message}"
    );
}
