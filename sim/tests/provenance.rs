//! Every table that ships says what its numbers are, where they come from, how wrong they can be, and under which licence.

use ditd_sim::light::table::Records;
use std::path::Path;

#[test]
fn every_shipped_table_has_status_source_uncertainty_and_licence() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    let mut seen = 0;
    for folder in ["optics", "fuels"] {
        for entry in std::fs::read_dir(data.join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.display();
            assert!(path.extension().is_some_and(|end| end == "csv"), "{name}: what is this?");
            let text = std::fs::read_to_string(&path).unwrap();
            let records = Records::parse(&text).unwrap_or_else(|error| panic!("{name}: {error}"));
            let own = records.provenance();
            assert!(own.status.is_some(), "{name}: `# status:` is missing");
            for (key, value) in
                [("source", &own.source), ("uncertainty", &own.uncertainty), ("licence", &own.licence)]
            {
                assert!(value.len() > 2, "{name}: `# {key}:` is missing");
            }
            assert!(!records.is_empty(), "{name} has no rows");
            seen += 1;
        }
    }
    assert!(seen >= 28, "{seen}");
}
