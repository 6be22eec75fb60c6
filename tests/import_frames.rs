//! Frames that other programs recorded become the same stack whatever their form: TIFF of one page or many, either byte
//! order, packed or not, raw, NPY. What is wrong is told with file and line.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

use ditd::estimate::map::Estimator;
use ditd::files::npy::{self, Array, Values};
use ditd::stack::Stack;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tiff::encoder::{Compression, DeflateLevel, TiffEncoder, colortype};

const BLANKS: usize = 3;

fn ditd(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ditd")).args(arguments).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A stack of the reference data, with three blanks for every spray frame: its own and two more that differ by a count here
/// and there.
struct Original {
    case: Value,
    rows: usize,
    columns: usize,
    pairs: Vec<usize>,
    plates: Vec<f64>,
    spray: Vec<Vec<u16>>,
    blanks: Vec<Vec<u16>>,
}

fn original() -> Original {
    let folder: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/fit/two_setpoints");
    let mut case: Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("case.json")).unwrap()).unwrap();
    let frames = |name: &str| {
        let array = npy::read(&folder.join(name)).unwrap();
        let [_, rows, columns] = array.shape[..] else { panic!("frames") };
        let Values::U16(counts) = array.values else { panic!("counts") };
        (rows, columns, counts.chunks(rows * columns).map(<[u16]>::to_vec).collect::<Vec<_>>())
    };
    let (rows, columns, spray) = frames("spray.npy");
    let (_, _, own) = frames("nospray.npy");
    let blanks = own
        .iter()
        .enumerate()
        .flat_map(|(i, frame)| {
            (0..BLANKS).map(move |b| {
                let change = |(j, count): (usize, &u16)| count + u16::from(b > 0 && (i + j) % (2 + b) == 0);
                frame.iter().enumerate().map(change).collect()
            })
        })
        .collect();
    case["blanks_per_spray"] = json!(BLANKS);
    let pairs = serde_json::from_value(case["pairs_per_setpoint"].clone()).unwrap();
    let plates = serde_json::from_value(case["setpoints_K"].clone()).unwrap();
    Original { case, rows, columns, pairs, plates, spray, blanks }
}

impl Original {
    /// Written straight as a stack.
    fn write_stack(&self, folder: &Path) {
        std::fs::create_dir_all(folder).unwrap();
        for (name, frames) in [("spray.npy", &self.spray), ("nospray.npy", &self.blanks)] {
            npy::write(&folder.join(name), &self.array(frames)).unwrap();
        }
        std::fs::write(folder.join("case.json"), self.case.to_string()).unwrap();
    }

    fn array(&self, frames: &[Vec<u16>]) -> Array {
        Array { shape: vec![frames.len(), self.rows, self.columns], values: Values::U16(frames.concat()) }
    }

    /// All frames as they were taken: before each spray frame its blanks, before the level a discarded one.
    fn in_time(&self) -> Vec<(usize, &'static str, usize, Vec<u16>)> {
        let mut out = Vec::new();
        let mut at = 0;
        for (level, &pairs) in self.pairs.iter().enumerate() {
            out.push((level, "discarded", 0, vec![0; self.rows * self.columns]));
            for cycle in 0..pairs {
                for blank in &self.blanks[at * BLANKS..(at + 1) * BLANKS] {
                    out.push((level, "blank", cycle, blank.clone()));
                }
                out.push((level, "spray", cycle, self.spray[at].clone()));
                at += 1;
            }
        }
        out
    }

    /// A table of frames of which `place` says file and page; with further columns.
    fn table(&self, place: impl Fn(usize) -> (String, usize), more: (&str, &str)) -> String {
        let mut text = format!("file,page,level,plate_temperature_k,kind,time_s,cycle{}\n", more.0);
        for (i, (level, kind, cycle, _)) in self.in_time().into_iter().enumerate() {
            let (file, page) = place(i);
            // Levels from hot to cold in the table, numbered by what they are.
            writeln!(text, "{file},{page},{level},{},{kind},{}.5,{cycle}{}", self.plates[level], i, more.1)
                .unwrap();
        }
        text
    }
}

fn tiff_pages(rows: usize, columns: usize, pages: &[Vec<u16>], packing: Compression) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut out).unwrap().with_compression(packing);
    for page in pages {
        let size = |n: usize| u32::try_from(n).unwrap();
        encoder.write_image::<colortype::Gray16>(size(columns), size(rows), page).unwrap();
    }
    out.into_inner()
}

/// A TIFF with the high byte first, as the specification (revision 6) lays it out: header, directory, one strip.
fn big_endian_tiff(rows: usize, columns: usize, counts: &[u16]) -> Vec<u8> {
    let mut out = b"MM\x00\x2a\x00\x00\x00\x08".to_vec();
    let entries: [(u16, u16, u32); 9] = [
        (256, 4, u32::try_from(columns).unwrap()),
        (257, 4, u32::try_from(rows).unwrap()),
        (258, 3, 16),
        (259, 3, 1),
        (262, 3, 1),
        (273, 4, 8 + 2 + 9 * 12 + 4),
        (277, 3, 1),
        (278, 4, u32::try_from(rows).unwrap()),
        (279, 4, u32::try_from(2 * counts.len()).unwrap()),
    ];
    out.extend(9_u16.to_be_bytes());
    for (tag, kind, value) in entries {
        out.extend(tag.to_be_bytes());
        out.extend(kind.to_be_bytes());
        out.extend(1_u32.to_be_bytes());
        // A short stands in the first half of its field.
        out.extend(if kind == 3 { value << 16 } else { value }.to_be_bytes());
    }
    out.extend(0_u32.to_be_bytes());
    out.extend(counts.iter().flat_map(|count| count.to_be_bytes()));
    out
}

/// Every form gives the frames of the stack to the bit, and the map of it to the bit.
#[test]
fn every_form_of_recording_gives_the_same_map() {
    let dir = tempfile::tempdir().unwrap();
    let one = original();
    let (rows, columns) = (one.rows, one.columns);
    let straight = dir.path().join("straight");
    one.write_stack(&straight);
    let mut stack = Stack::open(&straight).unwrap();
    let inputs = stack.inputs(Estimator::Default);
    let wanted = stack.fit(&inputs).unwrap();
    assert!(wanted.map.temperature_k.iter().any(|t| t.is_finite()));
    let frames: Vec<Vec<u16>> = one.in_time().into_iter().map(|(.., counts)| counts).collect();
    let case = straight.join("case.json");
    let forms = ["single", "big", "lzw", "deflate", "npy", "raw"];
    for form in forms {
        let folder = dir.path().join(form);
        std::fs::create_dir_all(&folder).unwrap();
        let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).unwrap();
        let table = match form {
            "single" | "big" => {
                for (i, counts) in frames.iter().enumerate() {
                    let bytes = if form == "big" {
                        big_endian_tiff(rows, columns, counts)
                    } else {
                        tiff_pages(rows, columns, std::slice::from_ref(counts), Compression::Uncompressed)
                    };
                    write(&format!("f{i:03}.tif"), &bytes);
                }
                one.table(|i| (format!("f{i:03}.tif"), 0), ("", ""))
            }
            "lzw" | "deflate" => {
                let packing =
                    if form == "lzw" { Compression::Lzw } else { Compression::Deflate(DeflateLevel::Fast) };
                write("all.TIFF", &tiff_pages(rows, columns, &frames, packing));
                one.table(|i| ("all.TIFF".into(), i), ("", ""))
            }
            "npy" => {
                npy::write(&folder.join("all.npy"), &one.array(&frames)).unwrap();
                one.table(|i| ("all.npy".into(), i), ("", ""))
            }
            _ => {
                // Two files, each behind a header of 100 bytes.
                for (name, part) in [("a.bin", &frames[..5]), ("b.bin", &frames[5..])] {
                    let mut bytes = vec![0xAB; 100];
                    bytes.extend(part.iter().flatten().flat_map(|count| count.to_be_bytes()));
                    write(name, &bytes);
                }
                let layout = format!(",100,{rows},{columns},big,14");
                one.table(
                    |i| if i < 5 { ("a.bin".into(), i) } else { ("b.bin".into(), i - 5) },
                    (",header_bytes,rows,columns,byte_order,bits", &layout),
                )
            }
        };
        let path = folder.join("table.csv");
        std::fs::write(&path, table).unwrap();
        let out = folder.join("stack");
        let told = ditd(&[
            "import-frames",
            path.to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
            "--case",
            case.to_str().unwrap(),
            "--saturated-max",
            "1",
            "--json",
        ]);
        assert!(told.status.success(), "{form}: {}", said(&told));
        let summary: Value = serde_json::from_slice(&told.stdout).unwrap();
        assert_eq!(summary["blanks_per_spray"], json!(BLANKS));
        assert_eq!(summary["discarded"], json!(one.pairs.len()));
        for name in ["spray.npy", "nospray.npy"] {
            assert_eq!(
                npy::read(&out.join(name)).unwrap(),
                npy::read(&straight.join(name)).unwrap(),
                "{form}"
            );
        }
        let mut stack = Stack::open(&out).unwrap();
        let inputs = stack.inputs(Estimator::Default);
        let found = stack.fit(&inputs).unwrap();
        for (a, b) in found.map.channels().iter().zip(wanted.map.channels()) {
            let bits = |v: &[f64]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(a), bits(b), "{form}");
        }
        assert_eq!((found.map.flags, found.map.count), (wanted.map.flags.clone(), wanted.map.count.clone()));
        // A stack is never overwritten.
        let again = ditd(&["import-frames", path.to_str().unwrap(), "--out", out.to_str().unwrap()]);
        assert_eq!(again.status.code(), Some(2));
    }
}

/// Without cycle numbers the order of time pairs; without a case the window and the plate are assumed, and told; without a
/// curve the fit asks for one.
#[test]
fn a_table_alone_makes_a_stack() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let frame = |count: u16| Array { shape: vec![2, 2], values: Values::U16(vec![count; 4]) };
    let mut table = String::from("file,kind,plate_temperature_k,time_s\n");
    // Written backwards in time, levels by temperature.
    for (i, (kind, plate, count)) in
        [("spray", 460.0, 130), ("blank", 460.0, 150), ("spray", 400.0, 90), ("blank", 400.0, 80)]
            .iter()
            .enumerate()
    {
        npy::write(&dir.path().join(format!("{i}.npy")), &frame(*count)).unwrap();
        writeln!(table, "{i}.npy,{kind},{plate},{}", 10 - i).unwrap();
    }
    std::fs::write(at("t.csv"), table).unwrap();
    let told = ditd(&["import-frames", &at("t.csv"), "--out", &at("s")]);
    assert!(told.status.success(), "{}", said(&told));
    assert!(String::from_utf8(told.stdout).unwrap().contains("gamma = 1"));
    let case: Value = serde_json::from_str(&std::fs::read_to_string(at("s/case.json")).unwrap()).unwrap();
    assert_eq!(case["setpoints_K"], json!([400.0, 460.0]));
    let Values::U16(spray) = npy::read(Path::new(&at("s/spray.npy"))).unwrap().values else {
        panic!("counts")
    };
    assert_eq!((spray[0], spray[4]), (90, 130));
    assert_eq!(ditd(&["fit", &at("s"), "--out", &at("map")]).status.code(), Some(2));
    std::fs::write(at("curve.json"), r#"{"A": 7.2e4, "a_um": 3.4, "b_um_K": 1.5}"#).unwrap();
    let told = ditd(&["fit", &at("s"), "--out", &at("map"), "--calibration", &at("curve.json")]);
    assert!(told.status.success(), "{}", said(&told));
}

/// Everything that can be wrong with a table, with what the message must name.
#[test]
fn wrong_tables_are_told_with_file_and_line() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let save = |name: &str, rows: usize, count: u16| {
        let array = Array { shape: vec![rows, 2], values: Values::U16(vec![count; 2 * rows]) };
        npy::write(&dir.path().join(name), &array).unwrap();
    };
    save("a.npy", 2, 100);
    save("b.npy", 2, 90);
    save("c.npy", 3, 90);
    save("hot.npy", 2, 4095);
    std::fs::write(at("short.raw"), [1, 2, 3]).unwrap();
    std::fs::write(at("broken.tif"), b"II*\x00 no tiff").unwrap();
    let head = "file,level,plate_temperature_k,kind,cycle\n";
    let good = "a.npy,0,400,spray,1\nb.npy,0,400,blank,1\n";
    let cases: [(&str, &str, &[&str]); 14] = [
        (head, "a.npy,0,400,spray,1\nno.npy,0,400,blank,1\n", &["no.npy", ":3"]),
        (head, "a.npy,0,400,spray,1\nc.npy,0,400,blank,1\n", &["c.npy", ":3", "3 x 2"]),
        (head, "a.npy,0,400,spray,1\nhot.npy,0,400,blank,1\n", &["hot.npy", ":3", "saturated"]),
        (head, "a.npy,0,400,spray,1\nb.npy,0,400,blank,2\n", &["b.npy", ":3", "cycle 2"]),
        (head, "a.npy,0,400,spray,1\nb.npy,0,400,blank,\n", &["b.npy", ":3"]),
        (head, "a.npy,0,400,spray,1\n", &[":2", "1 spray and 0 blank"]),
        (head, "a.npy,0,warm,spray,1\nb.npy,0,400,blank,1\n", &[":2", "warm"]),
        (head, "a.npy,0,-3,spray,1\nb.npy,0,400,blank,1\n", &[":2", "above 0 K"]),
        (head, "a.npy,0,400,fog,1\nb.npy,0,400,blank,1\n", &[":2", "fog"]),
        (head, "a.npy,0,400,spray,1\na.npy,0,400,blank,1\n", &["a.npy", ":3", "line 2"]),
        (head, "a.npy,0,400,spray,1\nshort.raw,0,400,blank,1\n", &[":3", "header_bytes"]),
        (head, "a.npy,0,400,spray,1\nbroken.tif,0,400,blank,1\n", &["broken.tif", ":3"]),
        (head, "", &["no frames"]),
        ("level,kind\n", "0,spray\n", &["`file`"]),
    ];
    for (head, body, wanted) in cases {
        std::fs::write(at("t.csv"), format!("{head}{body}")).unwrap();
        let out = dir.path().join("out");
        let told = ditd(&["import-frames", &at("t.csv"), "--out", &at("out"), "--saturation-count", "4095"]);
        assert_eq!(told.status.code(), Some(2), "{body}");
        for word in wanted {
            assert!(said(&told).contains(word), "{body} should name {word}: {}", said(&told));
        }
        assert!(["case.json", "spray.npy", "nospray.npy"].iter().all(|name| !out.join(name).exists()));
    }
    // Raw files whose size is not what was stated; then the same files as they are.
    std::fs::write(at("t.csv"), format!("{head}{good}")).unwrap();
    assert!(ditd(&["import-frames", &at("t.csv"), "--out", &at("out")]).status.success());
    std::fs::write(at("t.csv"), format!("{head}short.raw,0,400,spray,1\nb.npy,0,400,blank,1\n")).unwrap();
    let layout = [
        "--raw-header-bytes",
        "0",
        "--raw-rows",
        "2",
        "--raw-columns",
        "2",
        "--raw-byte-order",
        "little",
        "--raw-bits",
        "16",
    ];
    let (table, out) = (at("t.csv"), at("out2"));
    let told = ditd(&[["import-frames", &table, "--out", &out].as_slice(), &layout].concat());
    assert!(said(&told).contains("short.raw") && said(&told).contains("3 bytes"), "{}", said(&told));
    // Two blanks for one spray frame, one for another.
    let uneven = "a.npy,0,400,spray,1\nb.npy,0,400,blank,1\nd.npy,0,400,spray,2\ne.npy,0,400,blank,2\nf.npy,0,400,blank,2\n";
    ["d.npy", "e.npy", "f.npy"].iter().for_each(|name| save(name, 2, 95));
    std::fs::write(at("t.csv"), format!("{head}{uneven}")).unwrap();
    let told = ditd(&["import-frames", &at("t.csv"), "--out", &at("out3")]);
    assert!(said(&told).contains("d.npy") && said(&told).contains("2 blanks"), "{}", said(&told));
}
