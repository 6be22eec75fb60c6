//! `ditd render --rays`: a table of single rays.

use super::collected::trace_mirrored;
use super::columns::Columns;
use super::{Args, RAY_TARGET};
use crate::commands::{CommandError, CommandResult, print};
use ditd_sim::scene::file::Scene;
use std::fmt::Write as _;
use std::path::Path;

pub(super) fn single_rays(scene: &Scene, path: &Path, args: &Args) -> CommandResult {
    let text = if path == Path::new("-") {
        std::io::read_to_string(std::io::stdin())
    } else {
        std::fs::read_to_string(path)
    };
    let text = text.map_err(|e| CommandError::usage(format!("render: reading {}: {e}", path.display())))?;
    let table = RayTable::parse(&text)
        .map_err(|e| CommandError::usage(format!("render: {}: {e}", path.display())))?;
    let walls = scene.surroundings(&[]);
    if scene.camera.as_ref().is_some_and(|c| c.lens.is_some()) || scene.exposure.is_some() {
        eprintln!("ditd: single rays pass no lens and see the middle of the exposure");
    }
    let target_error = args.target_error.unwrap_or(RAY_TARGET);
    let collected = trace_mirrored(scene, walls, &table.rays, target_error, args.seed())?;
    let columns = Columns::new(scene, args.groups, walls.apart().is_some());
    let names = columns.names();
    let rows = (0..table.rays.len()).map(|sight| columns.values(collected.of(sight)));
    if args.json {
        let list: Vec<serde_json::Value> = rows
            .map(|row| names.iter().zip(row).map(|(n, v)| (n.clone(), serde_json::json!(v))).collect())
            .collect();
        return print(&format!("{}\n", serde_json::json!({ "rays": list })));
    }
    let mut out = format!("{},{}\n", table.header, names.join(","));
    for (line, row) in table.lines.iter().zip(rows) {
        out.push_str(line);
        for value in row {
            // 17 significant digits; an unknown radiance is an empty field.
            if value.is_nan() {
                out.push(',');
            } else {
                let _ = write!(out, ",{value:.16e}");
            }
        }
        out.push('\n');
    }
    print(&out)
}

/// The rays of a CSV file, with their lines as they were.
struct RayTable {
    header: String,
    lines: Vec<String>,
    rays: Vec<([f64; 3], [f64; 3])>,
}

impl RayTable {
    fn parse(text: &str) -> Result<Self, String> {
        let names = ["origin_x_m", "origin_y_m", "origin_z_m", "direction_x", "direction_y", "direction_z"];
        let mut lines =
            text.lines().enumerate().map(|(i, l)| (i + 1, l.trim_end())).filter(|(_, l)| !l.is_empty());
        let (_, header) = lines.next().ok_or("it is empty")?;
        let columns: Vec<&str> = header.split(',').map(str::trim).collect();
        let mut places = [0; 6];
        for (place, name) in places.iter_mut().zip(names) {
            *place =
                columns.iter().position(|c| *c == name).ok_or_else(|| format!("it has no column {name}"))?;
        }
        let mut table = Self { header: header.to_owned(), lines: Vec::new(), rays: Vec::new() };
        for (number, line) in lines {
            let cells: Vec<&str> = line.split(',').map(str::trim).collect();
            let mut v = [0.0; 6];
            for ((value, &place), name) in v.iter_mut().zip(&places).zip(names) {
                *value = cells
                    .get(place)
                    .and_then(|c| c.parse().ok())
                    .ok_or_else(|| format!("line {number}: {name} is not a number"))?;
            }
            table.rays.push(([v[0], v[1], v[2]], [v[3], v[4], v[5]]));
            table.lines.push(line.to_owned());
        }
        Ok(table)
    }
}
