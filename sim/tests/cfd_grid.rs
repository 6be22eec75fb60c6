//! Sprays on the tracer's grid: what the planes in the CFD's cells are worth, that walls and sectors lose nothing, and
//! that columns are those of the reference.

use ditd_sim::scene::compact;
use ditd_sim::scene::deposit::{self, DepositOptions, Sectors};
use ditd_sim::scene::field::{CfdSpray, GasCell, Parcel, SprayField};

/// A vessel 24 mm wide of cells of 1 mm, with a Gaussian cloud of vapour of standard deviation 2.5 mm.
fn gaussian() -> CfdSpray {
    let mut cells = Vec::new();
    for i in 0..24_u32.pow(3) {
        let lower_m = [i / 576, i / 24 % 24, i % 24].map(|v| f64::from(v) * 1e-3 - 12e-3);
        cells.push(GasCell {
            lower_m,
            upper_m: lower_m.map(|x| x + 1e-3),
            temperature_k: 500.0 - 1e3 * lower_m[2],
            pressure_pa: 4e5,
            density_kg_m3: 3.0,
            // Means over the cell by Simpson's rule: 4e-6 off.
            fuel_mass_fraction: 0.5 * lower_m.iter().map(|&x| simpson(x, 1e-3)).product::<f64>(),
        });
    }
    CfdSpray {
        time_s: 1e-3,
        parcels: None,
        liquid_density_kg_m3: None,
        cells: Some(cells),
        shaped_cells: 0,
        remainder: None,
        domain_m: Some([[-12e-3; 3], [12e-3; 3]]),
        fuel: "C7H16".into(),
        fuel_molar_mass_kg_mol: 0.1,
        carrier_molar_mass_kg_mol: 0.028,
        notes: Vec::new(),
    }
}

fn shape(x: f64) -> f64 {
    (-0.5 * (x / 2.5e-3).powi(2)).exp()
}

fn simpson(lower: f64, length: f64) -> f64 {
    (shape(lower) + 4.0 * shape(lower + 0.5 * length) + shape(lower + length)) / 6.0
}

/// Mean absolute difference of the grid's vapour from the Gaussian, over its peak (15 mol/m³), where there is vapour.
fn error(field: &SprayField) -> f64 {
    let size = field.grid.cell_m();
    let mut sum = 0.0;
    for (&cell, gas) in field.cells.iter().zip(&field.gas) {
        let at = field.grid.cell(cell as usize);
        let exact: f64 =
            (0..3).map(|a| simpson(field.grid.lower_m[a] + at[a] as f64 * size[a], size[a])).product();
        sum += (gas.vapour_mol_m3 / 15.0 - exact).abs();
    }
    sum * field.grid.cell_volume_m3() / 2.5e-3_f64.powi(3)
}

#[test]
fn planes_halve_the_error_of_blocks_again_and_again() {
    let spray = gaussian();
    let fine = DepositOptions { cell_m: Some(0.25e-3), ..DepositOptions::default() };
    let (field, report) = deposit::field(&spray, &fine).unwrap();
    assert!(report.vapour_error < 1e-12, "{report:?}");
    let planes = error(&field);
    // The same without neighbours: each cell a spray of its own, painted as a block.
    let mut blocks = 0.0;
    let cells = spray.cells.as_ref().unwrap();
    let size = 0.25e-3;
    for cell in cells {
        for i in 0..64_u32 {
            let part = [i / 16, i / 4 % 4, i % 4];
            let exact: f64 =
                (0..3).map(|a| simpson(cell.lower_m[a] + f64::from(part[a]) * size, size)).product();
            blocks += (2.0 * cell.fuel_mass_fraction - exact).abs() * (size / 2.5e-3_f64).powi(3);
        }
    }
    // Second order against first: the ratio is about the cell over four standard deviations; limiters cost some.
    assert!(planes < 0.25 * blocks, "{planes} against {blocks}");
    // The mean temperature of the vapour stays, though both vary.
    let moles = |f: &SprayField| f.gas.iter().map(|g| g.vapour_mol_m3).sum::<f64>();
    let warmth: f64 = field.gas.iter().map(|g| g.vapour_mol_m3 * g.temperature_k).sum();
    let expected = spray.totals().t_gas_vapour_mean_k.unwrap();
    // 7e-6 of the vapour is in cells below the limit.
    assert!((warmth / moles(&field) / expected - 1.0).abs() < 1e-6, "{} {expected}", warmth / moles(&field));
}

#[test]
fn the_grid_is_as_fine_as_affordable_and_lies_where_the_vessel_does() {
    let spray = gaussian();
    let (field, report) = deposit::field(&spray, &DepositOptions::default()).unwrap();
    assert!(report.vapour_cells <= 220_000 && report.cell_m[0] < 0.6e-3, "{report:?}");
    for a in 0..3 {
        let lines = (field.grid.lower_m[a] + 12e-3) / report.cell_m[a];
        assert!((lines - lines.round()).abs() < 1e-6 && field.grid.lower_m[a] > -12e-3 - 1e-12);
        assert!(field.grid.upper_m[a] < 12e-3 + 1e-12);
    }
}

#[test]
fn no_droplet_passes_a_wall_and_none_is_lost_there() {
    let mut spray = gaussian();
    // A sheet of parcels on a wall, and one in a corner.
    let at = |x: f64, y: f64, z: f64| Parcel {
        position_m: [x, y, z],
        diameter_m: 1e-5,
        temperature_k: 380.0,
        droplets: 100.0,
    };
    let mut parcels: Vec<Parcel> = (0..400_u32)
        .map(|i| at(12e-3, f64::from(i / 20) * 5e-4 - 5e-3, f64::from(i % 20) * 5e-4 - 5e-3))
        .collect();
    parcels.push(at(-12e-3, -12e-3, 12e-3));
    spray.parcels = Some(parcels);
    let (field, report) = deposit::field(&spray, &DepositOptions::default()).unwrap();
    assert!((0..3).all(|a| field.grid.lower_m[a] > -12e-3 - 1e-12 && field.grid.upper_m[a] < 12e-3 + 1e-12));
    let volume = field.grid.cell_volume_m3();
    let droplets: f64 = field.deposit_per_m3.iter().map(|&n| f64::from(n) * volume).sum();
    assert!((droplets / 40_100.0 - 1.0).abs() < 1e-6 && report.droplet_error < 1e-12, "{droplets}");
    assert_eq!(report.outside_parcels, 0);
}

#[test]
fn a_quarter_makes_the_whole() {
    let mut spray = compact::shipped().unwrap();
    let quarter = |p: [f64; 3]| p[0] >= 0.0 && p[1] >= 0.0;
    spray.parcels.as_mut().unwrap().retain(|p| quarter(p.position_m));
    spray.cells.as_mut().unwrap().retain(|c| quarter(c.lower_m));
    spray.liquid_density_kg_m3 = None;
    spray.domain_m = Some([[0.0, 0.0, -0.064], [0.032, 0.032, 0.0]]);
    let (_, one) = deposit::field(&spray, &DepositOptions::default()).unwrap();
    for (number, tolerance) in [(4, 1e-9), (8, 1e-9)] {
        let sectors = Sectors { number, tip_m: [0.0; 3], axis: [0.0, 0.0, -1.0] };
        let options = DepositOptions { sectors: Some(sectors), ..DepositOptions::default() };
        let (field, whole) = deposit::field(&spray, &options).unwrap();
        let times = f64::from(number);
        assert!((whole.droplets / one.droplets / times - 1.0).abs() < tolerance, "{whole:?}");
        let (all, part) =
            (whole.vapour_mol + whole.outside_vapour_mol, times * (one.vapour_mol + one.outside_vapour_mol));
        assert!((all / part - 1.0).abs() < tolerance && whole.vapour_error < 1e-12, "{whole:?}");
        assert!(
            field.grid.lower_m[0] < -0.01 && field.grid.lower_m[1] < -0.01 && field.grid.upper_m[0] > 0.01
        );
    }
}
