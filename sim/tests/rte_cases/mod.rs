//! Reference cases of radiative transfer as scenes: shared by the quick tests and by the full accuracy bench.
//!
//! The tables stand in `tests/data/rte` with their origin in its README; none was made with this tracer.

#![expect(unreachable_pub, reason = "shared by a test and a bench")]

use ditd_sim::light::phase::{PhaseFunction, PhaseTable};
use ditd_sim::tracer::medium::GridMedium;
use ditd_sim::tracer::plate::{Plate, PlateShape};
use ditd_sim::tracer::rays::{RayAnswer, RayOptions, render_rays};
use ditd_sim::tracer::shape::{Body, Shape, ShapeMedium};
use std::sync::Arc;

/// One row: what was asked, what came out, and z = (ours − reference) / combined standard error.
pub struct Row {
    pub name: String,
    pub answer: RayAnswer,
    /// Coefficient, reference, its standard error, ours, our standard error.
    pub values: Vec<(&'static str, f64, f64, f64, f64)>,
}

impl Row {
    pub fn z(&self) -> impl Iterator<Item = f64> {
        self.values
            .iter()
            .filter(|v| v.4 > 0.0)
            .map(|&(_, want, se_want, got, se_got)| (got - want) / se_want.hypot(se_got))
    }
}

pub fn table(name: &str) -> Vec<Vec<String>> {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/rte").join(name);
    let text = std::fs::read_to_string(&path).expect("the table is part of the repository");
    text.lines().skip(1).map(|l| l.split(',').map(str::to_owned).collect()).collect()
}

pub fn json(name: &str) -> serde_json::Value {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/rte").join(name);
    let text = std::fs::read_to_string(&path).expect("the table is part of the repository");
    serde_json::from_str(&text).expect("valid JSON")
}

pub fn number(text: &str) -> f64 {
    text.parse().expect("a number")
}

/// The reference's phase functions by name.
pub fn phase(name: &str) -> PhaseFunction {
    match name {
        "iso" => PhaseFunction::Isotropic,
        "hg0_5" => PhaseFunction::HenyeyGreenstein { asymmetry: 0.5 },
        "hg0_9" => PhaseFunction::HenyeyGreenstein { asymmetry: 0.9 },
        "mie_a" => {
            let value = json("phase_mie_a.json");
            let chi: Vec<f64> = value["chi"]
                .as_array()
                .expect("moments")
                .iter()
                .map(|c| c.as_f64().expect("a number"))
                .collect();
            let n = 4000;
            let theta: Vec<f64> =
                (0..=n).map(|i| std::f64::consts::PI * f64::from(i) / f64::from(n)).collect();
            let p: Vec<f64> = theta.iter().map(|t| legendre_series(&chi, t.cos())).collect();
            PhaseFunction::Table(Arc::new(PhaseTable::new(&theta, &p).expect("a phase function").0))
        }
        other => panic!("unknown phase function {other}"),
    }
}

fn legendre_series(chi: &[f64], mu: f64) -> f64 {
    let (mut before, mut now, mut sum) = (0.0, 1.0, 0.0);
    for (l, c) in chi.iter().enumerate() {
        let l = l as f64;
        sum += (2.0 * l + 1.0) * c * now;
        (before, now) = (now, ((2.0 * l + 1.0) * mu * now - l * before) / (l + 1.0));
    }
    sum
}

/// A row of slab_scatter.csv.
pub fn slab(row: &[String], options: &RayOptions) -> Row {
    slab_of(phase(&row[1]), row, number(&row[2]), number(&row[3]), options)
}

/// The same with another phase function, albedo and optical depth.
pub fn slab_of(phase: PhaseFunction, row: &[String], omega: f64, tau: f64, options: &RayOptions) -> Row {
    let [mu_cone, mu] = [4, 5].map(|i| number(&row[i]));
    let medium =
        ShapeMedium { shape: Shape::Slab { thickness_m: 0.01, optical_depth: tau }, albedo: omega, phase };
    let half_angle_deg = if mu_cone > 0.0 { mu_cone.acos().to_degrees() } else { 90.0 };
    let plate = Plate::new(&PlateShape::Cone { facing: [0.0, 0.0, 1.0], half_angle_deg }).expect("a plate");
    let body = Body::shape(&medium).expect("a slab");
    let ray = ([0.0, 0.0, 1.0], [(1.0 - mu * mu).sqrt(), 0.0, -mu]);
    let answer = render_rays(&body, &[ray], Some(&plate), options).expect("rays").remove(0);
    let want = [6, 7, 8].map(|i| number(&row[i]));
    let values = vec![
        ("a_plate", want[0], 1e-9, answer.plate, answer.se_plate),
        ("a_walls", want[1], 1e-9, answer.walls, answer.se_walls),
        ("a_medium", want[2], 1e-9, answer.medium[0], answer.se_medium[0]),
    ];
    Row {
        name: format!("slab {} {} omega {omega} tau {tau} cone {mu_cone:.3} mu {mu}", row[0], row[1]),
        answer,
        values,
    }
}

/// A row of semi_infinite_isotropic.csv.
pub fn half_space(row: &[String], options: &RayOptions) -> Row {
    let [omega, mu] = [0, 1].map(|i| number(&row[i]));
    let shape = Shape::Slab { thickness_m: 0.01, optical_depth: f64::INFINITY };
    let medium = ShapeMedium { shape, albedo: omega, phase: PhaseFunction::Isotropic };
    let body = Body::shape(&medium).expect("a half space");
    let ray = ([0.0, 0.0, 1.0], [(1.0 - mu * mu).sqrt(), 0.0, -mu]);
    let answer = render_rays(&body, &[ray], None, options).expect("rays").remove(0);
    let values = vec![
        ("a_medium", number(&row[3]), 1e-13, answer.medium[0], answer.se_medium[0]),
        ("a_walls", number(&row[4]), 1e-13, answer.walls, answer.se_walls),
    ];
    Row { name: format!("half space omega {omega} mu {mu}"), answer, values }
}

/// The medium of a case of grid3d.csv: channels all, x < 0, x ≥ 0.
pub fn grid_medium(case: &str) -> (GridMedium, PlateShape) {
    let (n, omega, g, half, y, total) = match case {
        "blob" => (16, 0.6, 0.85, 0.5, 1.5, 1_707.634_473_487_874),
        "jets" => (24, 0.5, 0.8, 0.8, 2.0, 11_941.588_359_779_77),
        other => panic!("unknown case {other}"),
    };
    let square = |v: f64| v * v;
    let mut medium = GridMedium {
        lower_m: [-1.0; 3],
        upper_m: [1.0; 3],
        cells: [n; 3],
        groups: 1,
        channels: 3,
        index: (0..u32::try_from(n * n * n).expect("few cells")).collect(),
        k_ext: vec![],
        k_sca: vec![],
        emission: vec![],
        phase: vec![PhaseFunction::HenyeyGreenstein { asymmetry: g }],
    };
    let centre = |i: usize| -1.0 + (2 * i + 1) as f64 / n as f64;
    for i in 0..n * n * n {
        let (x, y, z) = (centre(i / (n * n)), centre(i / n % n), centre(i % n));
        let k = if case == "blob" {
            5.0 * (-(x * x + y * y + z * z) / (2.0 * square(0.35))).exp()
        } else {
            12.0 * (-(square(x - 0.35) + y * y) / (2.0 * square(0.15))).exp()
                + 7.0 * (-(square(x + 0.3) + square(y - 0.2)) / (2.0 * square(0.2))).exp()
        };
        medium.k_ext.push(k);
        medium.k_sca.push(omega * k);
        let absorbed = (1.0 - omega) * k;
        let left = if x < 0.0 { absorbed } else { 0.0 };
        medium.emission.extend([absorbed, left, absorbed - left]);
    }
    let sum: f64 = medium.k_ext.iter().sum();
    assert!((sum / total - 1.0).abs() < 1e-12, "{sum}");
    let plate = PlateShape::Rectangle {
        centre_m: [0.0, y, 0.0],
        facing: [0.0, -1.0, 0.0],
        width_m: 2.0 * half,
        height_m: 2.0 * half,
    };
    (medium, plate)
}

/// A row of grid3d.csv.
pub fn grid(row: &[String], options: &RayOptions) -> Row {
    let (medium, plate) = grid_medium(&row[0]);
    let plate = Plate::new(&plate).expect("a plate");
    let body = Body::grid(&medium, 0).expect("a grid");
    let ray = ([number(&row[1]), -3.0, number(&row[2])], [0.0, 1.0, 0.0]);
    let answer = render_rays(&body, &[ray], Some(&plate), options).expect("rays").remove(0);
    let v = |i: usize| number(&row[i]);
    let transmitted = answer.direct_transmittance;
    assert!((transmitted - v(3)).abs() < 1e-12, "{transmitted} {}", v(3));
    let values = vec![
        ("a_plate", v(4), v(8), answer.plate, answer.se_plate),
        ("a_walls", v(5), v(9), answer.walls, answer.se_walls),
        ("a_left", v(6), v(10), answer.medium[1], answer.se_medium[1]),
        ("a_right", v(7), v(11), answer.medium[2], answer.se_medium[2]),
    ];
    Row { name: format!("grid {} x {} z {}", row[0], row[1], row[2]), answer, values }
}

/// Largest |z| and rms z of many rows.
pub fn summary(rows: &[Row]) -> (f64, f64) {
    let z: Vec<f64> = rows.iter().flat_map(Row::z).collect();
    let largest = z.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    (largest, (z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64).sqrt())
}
