//! What `ditd render` tells of its work.

use super::count;
use super::image::Images;
use crate::commands::{CommandResult, print};
use ditd_sim::scene::deposit::DepositReport;
use ditd_sim::scene::optics::{OpticsReport, Work};

pub(super) fn report(images: &Images, json: bool) -> CommandResult {
    let means: Vec<(String, f64)> =
        images.channels.iter().map(|(name, values)| (format!("mean_{name}"), mean(values))).collect();
    let all = images.stats.iter().chain(&means);
    if json {
        let map: serde_json::Map<String, serde_json::Value> =
            all.map(|(name, value)| (name.clone(), serde_json::json!(value))).collect();
        return print(&format!("{}\n", serde_json::Value::Object(map)));
    }
    let lines: Vec<String> = all.map(|(name, value)| format!("{name:24} {value}")).collect();
    print(&format!("{}\n", lines.join("\n")))
}

/// Mean over an image; 0 of none.
pub(super) fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&x| f64::from(x)).sum::<f64>() / count(values.len().max(1))
}

/// What the coefficients of a spray took, and what was left out: groups and the most that it can cost.
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
pub(super) fn optics_stats(report: &OpticsReport) -> Vec<(String, f64)> {
    let mut stats = vec![
        ("mie_spheres".to_owned(), report.mie_spheres as f64),
        ("vapour_nodes".to_owned(), report.vapour_nodes as f64),
        ("phase_tables".to_owned(), report.phase_tables as f64),
    ];
    for work in [Work::Mie, Work::Vapour, Work::Phase] {
        let skips = || report.skipped.iter().filter(|skip| skip.work == work);
        let groups: usize = skips().map(|skip| skip.groups).sum();
        let error = skips().map(|skip| skip.admitted_error).fold(0.0, f64::max);
        stats.push((format!("skipped_{}_groups", work.name()), groups as f64));
        stats.push((format!("skipped_{}_error", work.name()), error));
    }
    stats
}

/// How the spray was spread on the grid: what got lost, and how much of the picture is parcel noise.
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
pub(super) fn deposit_stats(report: &DepositReport) -> Vec<(String, f64)> {
    let [x, y, z] = report.split_half;
    let stats = [
        ("spray_cell_m", report.cell_m[0]),
        ("spray_droplet_cells", report.droplet_cells as f64),
        ("spray_vapour_cells", report.vapour_cells as f64),
        ("spray_droplets", report.droplets),
        ("spray_outside_droplets", report.outside_droplets),
        ("spray_outside_parcels", report.outside_parcels as f64),
        ("spray_junk_parcels", report.junk_parcels as f64),
        ("spray_droplet_error", report.droplet_error),
        ("spray_vapour_mol", report.vapour_mol),
        ("spray_outside_vapour_mol", report.outside_vapour_mol),
        ("spray_vapour_error", report.vapour_error),
        ("n_eff", report.n_eff),
        ("n_eff_short", report.n_eff_short),
        ("kernel_m", report.kernel_m),
        ("split_half_x", x),
        ("split_half_y", y),
        ("split_half_z", z),
    ];
    stats.map(|(name, value)| (name.to_owned(), value)).to_vec()
}
