//! `ditd mie` as a user meets it: pictures are written, and what makes no sense ends with status 2 and says where.

#![expect(clippy::unwrap_used, reason = "the helpers of these tests fail the test")]

use std::path::Path;
use std::process::{Command, Output};

fn ditd(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ditd")).arg("mie").args(arguments).current_dir(folder).output().unwrap()
}

fn message(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn nasty_rows_end_with_status_2_and_their_number() {
    let folder = tempfile::tempdir().unwrap();
    let good = "3,1.4,0.1";
    for (bad, what) in [
        ("-3,1.4,0.1", "size parameter"),
        ("NaN,1.4,0.1", "size parameter"),
        ("inf,1.4,0.1", "size parameter"),
        ("3,1.4,-0.1", "index"),
        ("3,NaN,0.1", "index"),
        ("3,1.4,NaN", "index"),
        ("3,1.4,inf", "index"),
        ("3,0,0.1", "index"),
        ("3,-1.4,0.1", "index"),
        ("1e12,1.4,0.1", "size parameter"),
        ("three,1.4,0.1", "column `x`"),
        ("3,1.4,", "column `k`"),
        ("3,1.4", "2 fields"),
    ] {
        std::fs::write(folder.path().join("own.csv"), format!("x,n,k\n{good}\n{good}\n{bad}\n{good}\n"))
            .unwrap();
        let output = ditd(&["efficiencies", "own.csv", "--plot", "own.svg"], folder.path());
        let told = message(&output);
        assert_eq!(output.status.code(), Some(2), "{bad}: {told}");
        assert!(told.contains("own.csv, row 3") && told.contains(what), "{bad}: {told}");
        assert!(output.stdout.is_empty() && !folder.path().join("own.svg").exists(), "{bad}");
        for task in ["amplitudes", "cdf"] {
            let bad = format!("x,n,k,theta_deg\n{good},10\n{good},20\n{bad},30\n");
            std::fs::write(folder.path().join("angles.csv"), &bad).unwrap();
            let output = ditd(&[task, "angles.csv"], folder.path());
            assert_eq!(output.status.code(), Some(2), "{bad}");
            assert!(message(&output).contains("angles.csv, row 3"), "{bad}: {}", message(&output));
        }
    }
}

#[test]
fn a_table_can_be_drawn_and_is_printed_all_the_same() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("own.csv"), "x,n,k\n50,1.4,0.1\n0.1,1.4,0.1\n").unwrap();
    let plain = ditd(&["efficiencies", "own.csv"], folder.path());
    let drawn = ditd(&["efficiencies", "own.csv", "--plot", "own.svg"], folder.path());
    assert!(drawn.status.success() && plain.stdout == drawn.stdout, "{}", message(&drawn));
    let svg = std::fs::read_to_string(folder.path().join("own.svg")).unwrap();
    assert!(svg.starts_with("<svg xmlns=") && svg.contains("Q abs"));
    let output = ditd(&["efficiencies", "own.csv", "--plot", "own.jpg"], folder.path());
    assert!(output.status.code() == Some(2) && message(&output).contains(".svg"), "{}", message(&output));
}

#[test]
fn liquids_are_drawn_by_index_or_by_name() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [
        &["--n", "1.4", "--k", "0", "--radius-um", "1..2"][..],
        &["--fuel", "n-heptane", "--temperature-k", "353", "--wavelength-um", "3.4"],
        &["--patterns-um", "0.3,3"],
    ] {
        let output = ditd(&[&["figure", "--out", "own.svg"], arguments].concat(), folder.path());
        assert!(output.status.success(), "{arguments:?}: {}", message(&output));
        let svg = std::fs::read_to_string(folder.path().join("own.svg")).unwrap();
        assert!(svg.contains("mean cosine g") && !svg.contains("NaN"), "{arguments:?}");
        std::fs::remove_file(folder.path().join("own.svg")).unwrap();
    }
    for (arguments, told) in [
        (&["--k", "-0.1"][..], "index"),
        (&["--n", "NaN"], "index"),
        (&["--wavelength-um", "0"], "wavelength"),
        (&["--radius-um", "2..1"], "radii 2..1"),
        (&["--radius-um", "0..1"], "radii"),
        (&["--radius-um", "1"], ".."),
        (&["--radius-um", "1..1e9"], "size parameter"),
        (&["--patterns-um", "1,-1"], "--patterns-um"),
        (&["--fuel", "water"], "n-heptane"),
        (&["--fuel", "n-heptane", "--wavelength-um", "300"], "known from"),
        (&["--fuel", "n-heptane", "--n", "1.4"], "cannot be used"),
        (&["--temperature-k", "300"], "--fuel"),
    ] {
        let output = ditd(&[&["figure", "--out", "own.svg"], arguments].concat(), folder.path());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(message(&output).contains(told), "{arguments:?}: {}", message(&output));
        assert!(!folder.path().join("own.svg").exists());
    }
}
