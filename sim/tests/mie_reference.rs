//! Mie efficiencies against numbers that were made elsewhere: a second multiprecision table, of regimes where programs
//! break (indices up to 100 and down to 0.01, matched indices, lines, plasmons, arguments at zeros of the functions),
//! and the efficiencies of droplets at 3.4 µm that the paper's Fig. 2 shows.

#![expect(clippy::unwrap_used, reason = "the helpers of these tests fail the test")]

use ditd_sim::light::mie::{Efficiencies, Sphere, efficiencies, efficiencies_of_many, efficiencies_refined};
use std::f64::consts::PI;

/// A sphere, its five numbers with their condition numbers of x and of n and k, its name.
type Row = (Sphere, [(f64, f64, f64); 5], String);

fn table() -> Vec<Row> {
    let text = include_str!("data/light/mie_efficiencies_more.csv");
    let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    text.lines()
        .skip(1)
        .map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            let number = |name: &str| {
                fields[names.iter().position(|own| *own == name).unwrap()].parse::<f64>().unwrap()
            };
            let sphere = Sphere { size_parameter: number("x"), n: number("n"), k: number("k") };
            let wanted = ["qext", "qsca", "qabs", "qback", "g"]
                .map(|name| (number(name), number(&format!("cx_{name}")), number(&format!("cm_{name}"))));
            (sphere, wanted, format!("{} {}", fields[0], fields[1]))
        })
        .collect()
}

/// Rows outside the bound.
///
/// Relative bound: 2.2e-16 · (64 + x + 8·(cx + cm)), since the products m x and m² are rounded, which is a change of x
/// or of the index by a few 2⁻⁵³. Backscatter is the square of an alternating sum S with |S| = x √q and
/// Σ|terms| ≤ 2x², so its relative error is that of the terms times 2 Σ|terms|/|S|.
fn misses(answers: &[Efficiencies]) -> Vec<String> {
    let mut misses = Vec::new();
    for ((sphere, wanted, id), q) in table().into_iter().zip(answers) {
        let found = [q.q_ext, q.q_sca, q.q_abs, q.q_back, q.asymmetry];
        for (column, ((wanted, by_x, by_m), found)) in wanted.into_iter().zip(found).enumerate() {
            let x = sphere.size_parameter;
            let mut allowed = 2.2e-16 * (64.0 + x + 8.0 * (by_x + by_m)) * wanted.abs();
            if column == 3 {
                allowed *= 1.0 + 4.0 * x / wanted.sqrt();
            }
            let error = (found - wanted).abs();
            if error.is_nan() || error > allowed {
                misses
                    .push(format!("{id} column {column}: {found:e} against {wanted:e}, {}", error / allowed));
            }
        }
    }
    misses
}

#[test]
fn every_row_of_the_second_table_is_met() {
    let spheres: Vec<Sphere> = table().into_iter().map(|row| row.0).collect();
    assert!(spheres.len() > 150);
    let alone: Vec<Efficiencies> =
        spheres.iter().map(|s| efficiencies(s.size_parameter, s.n, s.k).unwrap()).collect();
    let bad = misses(&alone);
    assert!(bad.is_empty(), "alone: {bad:#?}");
    let bad = misses(&efficiencies_of_many(&spheres).unwrap());
    assert!(bad.is_empty(), "side by side: {bad:#?}");
}

#[test]
fn narrow_lines_lose_nothing_when_they_are_refined() {
    let rows = table();
    let spheres: Vec<Sphere> = rows.iter().map(|row| row.0).collect();
    let (answers, again) = efficiencies_refined(&spheres).unwrap();
    let bad = misses(&answers);
    assert!(bad.is_empty() && again > 0, "{bad:#?}");
    for ((_, wanted, id), q) in rows.iter().zip(&answers).filter(|(row, _)| row.2.contains("resonance")) {
        for (found, column) in [(q.q_ext, 0), (q.q_sca, 1), (q.q_abs, 2), (q.asymmetry, 4)] {
            let wanted = wanted[column].0;
            assert!(
                (found - wanted).abs() <= 1e-12 * wanted.abs(),
                "{id} column {column}: {found:e}, {wanted:e}"
            );
        }
    }
}

/// Droplets at 3.4 µm with m = 1.38 + 0.09 i: radius in µm, then as printed x, Q_ext, Q_sca, Q_abs, Q_sca/Q_ext,
/// Q_sca/Q_abs, g. Own computation in arbitrary precision.
const FIGURE: &str = "\
0.1 0.1848 0.036831 0.000176 0.036655 0.0048 0.0048 0.00638
0.15 0.2772 0.056797 0.000890 0.055908 0.0157 0.0159 0.01434
0.2 0.3696 0.078984 0.002799 0.076185 0.0354 0.0367 0.02545
0.3 0.5544 0.134449 0.013882 0.120566 0.1033 0.1151 0.05724
0.5 0.9240 0.317751 0.094435 0.223315 0.2972 0.4229 0.16347
0.7 1.2936 0.599744 0.267684 0.332060 0.4463 0.8061 0.34679
1 1.8480 1.156671 0.641597 0.515074 0.5547 1.2456 0.65081
1.3 2.4024 1.722526 1.084103 0.638424 0.6294 1.6981 0.72076
1.7 3.1416 2.394067 1.601309 0.792758 0.6689 2.0199 0.81193
2 3.6960 2.775041 1.886462 0.888580 0.6798 2.1230 0.84011
2.5 4.6200 3.110378 2.106915 1.003463 0.6774 2.0996 0.86884
3 5.5440 3.130418 2.047055 1.083363 0.6539 1.8895 0.88166
4 7.3920 2.703712 1.530597 1.173115 0.5661 1.3047 0.88395
5 9.2400 2.357802 1.148290 1.209512 0.4870 0.9494 0.89120
7 12.9360 2.370189 1.174078 1.196111 0.4954 0.9816 0.94134
10 18.4800 2.260612 1.123548 1.137064 0.4970 0.9881 0.95466
15 27.7199 2.206207 1.126370 1.079837 0.5105 1.0431 0.95933
20 36.9599 2.171220 1.123974 1.047246 0.5177 1.0733 0.96130
30 55.4399 2.130965 1.119084 1.011881 0.5252 1.1059 0.96284
40 73.9198 2.108374 1.115453 0.992921 0.5291 1.1234 0.96354";

fn droplet(radius_um: f64) -> (f64, Efficiencies) {
    let x = 2.0 * PI * radius_um / 3.4;
    (x, efficiencies(x, 1.38, 0.09).unwrap())
}

#[test]
fn droplets_at_3_4_um_have_the_efficiencies_of_the_figure() {
    for line in FIGURE.lines() {
        let fields: Vec<&str> = line.split(' ').collect();
        let (x, q) = droplet(fields[0].parse().unwrap());
        let found = [x, q.q_ext, q.q_sca, q.q_abs, q.q_sca / q.q_ext, q.q_sca / q.q_abs, q.asymmetry];
        for (printed, found) in fields[1..].iter().zip(found) {
            let digits = printed.split_once('.').unwrap().1.len();
            assert_eq!(*printed, format!("{found:.digits$}"), "radius {} um", fields[0]);
        }
    }
}

#[test]
fn scattering_over_absorption_peaks_where_the_paper_says() {
    let radii: Vec<f64> = (0..=2700).map(|i| 0.1 * 10f64.powf(f64::from(i) / 1000.0)).collect();
    let peak = |value: &dyn Fn(&Efficiencies) -> f64| {
        radii.iter().map(|&r| (r, value(&droplet(r).1))).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap()
    };
    // "Diameter about the wavelength". The printed rows around a peak hold it between them, and are not above it.
    let (radius, ratio) = peak(&|q| q.q_sca / q.q_abs);
    assert!((1.7..2.5).contains(&radius) && (2.123..2.2).contains(&ratio), "{radius} {ratio}");
    let (radius, q_sca) = peak(&|q| q.q_sca);
    assert!((2.0..3.0).contains(&radius) && (2.1069..2.15).contains(&q_sca), "{radius} {q_sca}");
    let (radius, q_ext) = peak(&|q| q.q_ext);
    assert!((2.5..3.0).contains(&radius) && (3.1304..3.2).contains(&q_ext), "{radius} {q_ext}");
    // Both cross-sections can be larger or smaller than the geometric one.
    assert!(radii.iter().filter(|r| (2.5..=30.0).contains(*r)).all(|&r| droplet(r).1.q_abs > 1.0));
    assert!((droplet(5.0).1.q_abs - 1.21).abs() < 0.005 && droplet(1.0).1.q_sca < 1.0);
    // Below 0.29 µm (0.3 µm: 0.103) scattering is less than a tenth of extinction.
    assert!(radii.iter().filter(|r| **r < 0.29).all(|&r| droplet(r).1.q_sca < 0.1 * droplet(r).1.q_ext));
    // From 5 µm on about half is scattered; the paper's mirror effect is "a bit less than half".
    assert!(radii.iter().filter(|r| **r >= 5.0).all(|&r| {
        let q = droplet(r).1;
        (0.47..0.54).contains(&(q.q_sca / q.q_ext))
    }));
    let ratio = |r: f64| droplet(r).1.q_sca / droplet(r).1.q_abs;
    assert!((ratio(5.0) - 0.95).abs() < 0.005 && (ratio(50.0) - 1.13).abs() < 0.005);
    for (radius, g) in [(0.1, 0.006), (1.0, 0.65), (5.0, 0.89), (50.0, 0.964)] {
        assert!((droplet(radius).1.asymmetry - g).abs() < 0.002, "{radius} um");
    }
}

#[test]
fn the_peak_tells_the_index_to_a_hundredth() {
    // At 2 µm: 0.647 of the extinction for (1.36, 0.10), 0.680 for (1.38, 0.09), 0.713 for (1.40, 0.08).
    for (n, k, share) in [(1.36, 0.10, 0.647), (1.38, 0.09, 0.680), (1.40, 0.08, 0.713)] {
        let q = efficiencies(2.0 * PI * 2.0 / 3.4, n, k).unwrap();
        assert!((q.q_sca / q.q_ext - share).abs() < 5e-4, "{n} {k}: {}", q.q_sca / q.q_ext);
    }
}
