//! Radiosities against photons followed one by one, and what must hold for any enclosure.

use super::*;
use crate::tracer::plate::PlateShape;

fn chamber() -> Chamber {
    Chamber::new([-0.1, -0.15, -0.2], [0.1, 0.15, 0.2]).unwrap()
}

fn rectangle(y: f64, width_m: f64, height_m: f64) -> Plate {
    let shape =
        PlateShape::Rectangle { centre_m: [0.0, y, 0.0], facing: [0.0, -1.0, 0.0], width_m, height_m };
    Plate::new(&shape).unwrap()
}

fn plates() -> Vec<Plate> {
    let tilted = PlateShape::Disc { centre_m: [0.02, 0.1, 0.03], facing: [0.2, -1.0, 0.4], diameter_m: 0.09 };
    let cone = PlateShape::Cone { facing: [0.1, -1.0, 0.0], half_angle_deg: 40.0 };
    let mut plates = vec![rectangle(0.15, 0.1, 0.2), rectangle(0.1, 0.1, 0.2), rectangle(0.3, 0.2, 0.2)];
    plates.extend([Plate::new(&tilted).unwrap(), Plate::new(&cone).unwrap(), rectangle(0.15, 0.2, 0.4)]);
    plates
}

/// A simple generator of its own, so that nothing is shared with the tracer.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A place on a wall and a direction from it with the cosine law.
    fn leave(&mut self, side: usize) -> ([f64; 3], [f64; 3]) {
        let (low, high) = (chamber().lower_m(), chamber().upper_m());
        let mut place = [0, 1, 2].map(|a: usize| low[a] + self.next() * (high[a] - low[a]));
        place[side / 2] = if side.is_multiple_of(2) { low[side / 2] } else { high[side / 2] };
        let (cosine2, phi) = (self.next(), std::f64::consts::TAU * self.next());
        let sine = (1.0 - cosine2).sqrt();
        let mut direction = [0.0; 3];
        direction[side / 2] = cosine2.sqrt() * if side.is_multiple_of(2) { 1.0 } else { -1.0 };
        direction[(side / 2 + 1) % 3] = sine * phi.cos();
        direction[(side / 2 + 2) % 3] = sine * phi.sin();
        (place, direction)
    }
}

#[test]
fn an_isothermal_enclosure_shines_as_a_black_body_whatever_its_emissivities() {
    for plate in plates().iter().map(Some).chain([None]) {
        let enclosure = Enclosure::new(&chamber(), plate);
        for emissivity in [[1.0; 6], [1e-12; 6], [0.3, 0.9, 1e-300, 0.5, 1.0, 0.01]] {
            for own in [1.0, 0.2] {
                let map = enclosure.radiosity(&emissivity, own);
                for (surface, row) in map.map.iter().enumerate() {
                    let sum: f64 = row.iter().sum();
                    assert!((sum - 1.0).abs() < 1e-12 && row.iter().all(|&s| s >= 0.0), "{surface}: {sum}");
                }
                let (ends, plate) = map.lit(&[3.7e20; SOURCES]);
                assert_eq!((ends, plate), ([3.7e20; ENDS], 3.7e20));
            }
        }
    }
}

#[test]
fn rows_close_and_walls_and_plate_are_reciprocal() {
    let size: [f64; 3] = [0.2, 0.3, 0.4];
    for (n, plate) in plates().iter().enumerate() {
        let enclosure = Enclosure::new(&chamber(), Some(plate));
        let facing = Facing::new(&chamber(), plate);
        for surface in 0..SURFACES {
            let sum: f64 = enclosure.factors(surface).iter().sum();
            assert!((sum - 1.0).abs() < 1e-12, "plate {n}, surface {surface}: {sum}");
        }
        // Areas that are left of each wall from the exchange with its neighbours: G = A F must be symmetric.
        let exchange = view::exchange_areas(size);
        // The last one covers its wall up to the edges, where the quadrature of what it hides errs by 1e-5.
        let bound = if n + 1 < plates().len() { 1e-12 } else { 1e-6 };
        let left = |i: usize| -> f64 { (0..SIDES).map(|j| exchange[i][j] - facing.hidden[j][i]).sum() };
        for i in 0..SIDES {
            for j in 0..SIDES {
                let [there, back] = [left(i) * enclosure.factors[i][j], left(j) * enclosure.factors[j][i]];
                assert!((there - back).abs() < bound, "plate {n}: {i} {j}: {there} {back}");
            }
            if let Some(area) = plate.area_m2() {
                let [there, back] = [left(i) * enclosure.factors[i][PLATE], area * facing.seen[i]];
                assert!((there - back).abs() < bound, "plate {n}: {i}: {there} {back}");
            }
        }
    }
}

#[test]
fn plates_hide_what_rays_say_they_hide() {
    let chamber = chamber();
    for (n, plate) in plates().iter().enumerate() {
        let facing = Facing::new(&chamber, plate);
        let mut random = Random(11 + n as u64);
        let areas = [0.3 * 0.4, 0.2 * 0.4, 0.2 * 0.3];
        for (side, row) in facing.hidden.iter().enumerate() {
            let rays = 200_000_u32;
            let mut found = [0.0; SIDES];
            for _ in 0..rays {
                let (place, direction) = random.leave(side);
                if plate.hit(place, direction).is_some_and(|t| t > 1e-9) {
                    found[chamber.end(place, direction)] += 1.0;
                }
            }
            for (to, (&hidden, found)) in row.iter().zip(found).enumerate() {
                let (expected, found) = (hidden / areas[side / 2], found / f64::from(rays));
                // Four standard errors, and the quadrature where the plate touches walls.
                let sigma = (found.max(1.0 / f64::from(rays)) / f64::from(rays)).sqrt();
                assert!(
                    (expected - found).abs() < 4.0 * sigma + 2e-4,
                    "plate {n}, from {side}, hidden {to}: {expected} {found}"
                );
            }
        }
    }
}

/// Radiosity of each wall by photons that are mirrored from the wall that they meet: from the very place, or from anywhere
/// on it, which is what one radiosity per wall means.
fn photons(emissivity: &[f64; SIDES], plate: Option<&Plate>, anywhere: bool, seed: u64) -> [[f64; 3]; SIDES] {
    let mut random = Random(seed);
    std::array::from_fn(|start| {
        // Shares of the light that leaves a wall by origin: the hot wall 0, another wall, the plate.
        let mut sums = [0.0; 3];
        let paths = 200_000_u32;
        for _ in 0..paths {
            let mut side = start;
            let (mut place, mut direction) = random.leave(side);
            let origin = loop {
                if random.next() < emissivity[side] {
                    break usize::from(side != 0);
                }
                if plate.is_some_and(|p| p.hit(place, direction).is_some_and(|t| t > 1e-9)) {
                    break 2;
                }
                let met = chamber().end(place, direction);
                let (mut next, onward) = random.leave(met);
                if !anywhere {
                    let axis = met / 2;
                    let t = (next[axis] - place[axis]) / direction[axis];
                    next = [0, 1, 2].map(
                        |a: usize| {
                            if a == axis { next[a] } else { place[a] + t * direction[a] }
                        },
                    );
                }
                (side, place, direction) = (met, next, onward);
            };
            sums[origin] += 1.0 / f64::from(paths);
        }
        sums
    })
}

#[test]
fn radiosities_agree_with_photons() {
    // A flush plate covers part of its wall, so that places on that part do not count: one behind the chamber's wall
    // is seen through all of it, and a small one hides little of the walls from each other.
    let plate = rectangle(0.25, 0.1, 0.1);
    for emissivity in [[0.5; 6], [0.9, 0.2, 0.1, 0.3, 0.2, 0.1]] {
        for plate in [None, Some(&plate)] {
            let map = Enclosure::new(&chamber(), plate).radiosity(&emissivity, 1.0);
            for (anywhere, margin) in [(true, 2e-3), (false, 0.02)] {
                let margin = if plate.is_none() && anywhere { 0.0 } else { margin };
                let found = photons(&emissivity, plate, anywhere, 5);
                for (side, found) in found.iter().enumerate() {
                    let row = map.map[side];
                    let expected = [row[0], row[1..SIDES].iter().sum(), row[PLATE]];
                    for (e, f) in expected.iter().zip(found) {
                        let sigma = (f.max(1e-5) / 200_000.0).sqrt();
                        assert!(
                            (e - f).abs() < 4.0 * sigma + margin,
                            "{side} {anywhere}: {expected:?} {found:?}"
                        );
                    }
                }
            }
        }
    }
}
