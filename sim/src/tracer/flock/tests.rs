//! Paths together against paths one by one.

use super::super::chamber::{Chamber, ENDS};
use super::super::cuts::Limits;
use super::super::fine::Fine;
use super::super::medium::{EMPTY, GridMedium};
use super::super::paths::Memory;
use super::super::plate::{Plate, PlateShape};
use super::super::pyramid::Pyramid;
use super::super::scatter::Scatter;
use super::super::sobol::Sequence;
use super::super::spectrum::{Lane, One, ones};
use super::*;
use crate::light::phase::PhaseFunction;

const CELLS: [usize; 3] = [19, 13, 21];

/// Lumps of very different density between empty bricks; two channels.
fn lumps(albedo: f64, groups: usize) -> GridMedium {
    let mut medium = GridMedium {
        lower_m: [-0.1, 0.2, -0.3],
        upper_m: [0.4, 0.5, 0.3],
        cells: CELLS,
        groups,
        channels: 2,
        index: vec![EMPTY; CELLS.iter().product()],
        k_ext: Vec::new(),
        k_sca: Vec::new(),
        emission: Vec::new(),
        phase: (0..groups)
            .map(|g| PhaseFunction::HenyeyGreenstein { asymmetry: 0.6 - 0.4 * g as f64 })
            .collect(),
    };
    for (i, place) in medium.index.iter_mut().enumerate() {
        let number = hash(u32::try_from(i).unwrap());
        let x = i / (CELLS[1] * CELLS[2]);
        if (8..16).contains(&x) || number.is_multiple_of(3) {
            continue;
        }
        let k = [0.03, 3.0, 20.0, 200.0][number as usize / 3 % 4];
        *place = u32::try_from(medium.k_ext.len() / groups).unwrap();
        let own = |g: usize| k / (1.0 + g as f64) * (1.0 - albedo);
        let sources = [1.0, 1.0 + f64::from(number % 7)];
        medium.emission.extend(sources.iter().flat_map(|s| (0..groups).map(move |g| own(g) * s)));
        for g in 0..groups {
            medium.k_ext.push(k / (1.0 + g as f64));
            medium.k_sca.push(k / (1.0 + g as f64) * albedo);
        }
    }
    medium
}

/// Rows of every path (plate, walls, two channels, ends) by groups, one by one and together.
fn both<S: Spectrum>(medium: &GridMedium, limits: Limits, paths: u32) -> [Vec<f32>; 2] {
    let fine = Fine::<S>::new(medium, 1);
    let blocks = Blocks::new(&fine, &Pyramid::new(&fine), limits);
    let scatter = Scatter::new(&medium.phase);
    let shape = PlateShape::Rectangle {
        centre_m: [0.15, 0.7, 0.0],
        facing: [0.0, -1.0, 0.0],
        width_m: 0.5,
        height_m: 0.4,
    };
    let plate = Plate::new(&shape).unwrap();
    let chamber = Chamber::new([-0.5, -0.5, -0.5], [0.8, 0.9, 0.5]).unwrap();
    let world = World { blocks: &blocks, scatter: &scatter, plate: Some(&plate), chamber: Some(&chamber) };
    let begin = |i: u32| {
        let at = Sequence::new(5).from(i).next();
        let share = |d: usize| at.get(1000 + d);
        let size = [0.5, 0.3, 0.6];
        let origin = [0, 1, 2].map(|a: usize| medium.lower_m[a] + size[a] * share(a));
        // Every fourth one along an axis.
        let direction = if i.is_multiple_of(4) {
            [0, 1, 2].map(|a: usize| if a == i as usize / 4 % 3 { 1.0 } else { 0.0 })
        } else {
            turned([0.0, 1.0, 0.0], 2.0 * share(3) - 1.0, share(4))
        };
        (at, origin, direction)
    };
    let width = world.rows();
    assert_eq!(width, 4 + ENDS);
    let mut alone = vec![S::ZERO; paths as usize * width];
    let mut memory = Memory::new();
    for (i, rows) in (0..paths).zip(alone.chunks_exact_mut(width)) {
        let (at, origin, direction) = begin(i);
        world.follow(&at, (origin, direction), ones(medium.groups), Some(1.0), rows, &mut memory);
    }
    let mut together = vec![S::ZERO; paths as usize * width];
    let mut flock = Flock::new();
    let mut next = 0..paths;
    let more = || {
        next.next().map(|i| {
            let (at, origin, direction) = begin(i);
            Begin { at, origin, direction, weight: ones(medium.groups), set: i as usize }
        })
    };
    flock.run(&world, more, &mut together);
    assert!(flock.paths.iter().all(Option::is_none));
    let blocks = flock.visited as f64 / memory.blocks as f64;
    assert!((0.9..1.1).contains(&blocks), "{blocks}");
    [alone, together].map(|rows| rows.iter().flat_map(|row| (0..medium.groups).map(|g| row.get(g))).collect())
}

const EXACT: Limits = Limits { depth: 0.0, spread: 0.0, alone: f32::INFINITY };

fn straight<S: Spectrum>(groups: usize) {
    for limits in [EXACT, Limits { depth: 0.5, spread: 0.5, alone: f32::INFINITY }] {
        let [alone, together] = both::<S>(&lumps(0.0, groups), limits, 3000);
        for (i, (a, b)) in alone.iter().zip(&together).enumerate() {
            // The second channel is that of one block.
            if i / groups % (4 + ENDS) != 3 {
                // Through a depth of up to 5 by a length that errs by 1e-5 of a cell.
                assert!((a - b).abs() < 2e-4, "{i}: {a} {b}");
            }
        }
    }
}

#[test]
fn straight_rays_are_those_that_are_followed_alone() {
    straight::<One>(1);
    straight::<[Lane; 1]>(3);
}

fn means<S: Spectrum>(groups: usize, albedo: f64) {
    let n = 40_000;
    let [alone, together] = both::<S>(&lumps(albedo, groups), EXACT, n);
    for number in 0..groups * (4 + ENDS) {
        let moments = |rows: &[f32]| {
            let (mut sum, mut square) = (0.0_f64, 0.0_f64);
            for value in rows.iter().skip(number).step_by(groups * (4 + ENDS)) {
                sum += f64::from(*value);
                square += f64::from(*value).powi(2);
            }
            let mean = sum / f64::from(n);
            (mean, (square / f64::from(n) - mean * mean) / f64::from(n))
        };
        let ((a, va), (b, vb)) = (moments(&alone), moments(&together));
        assert!((a - b).abs() <= 4.5 * (va + vb).sqrt() + 1e-6, "{albedo}, {number}: {a} {b}");
        assert!(number >= 4 * groups || a > 0.01, "{albedo}, {number} is never met: {a}");
    }
    // What is not absorbed gets out: the mean weight is kept.
    for g in 0..groups {
        let all: f64 = together
            .chunks_exact(groups * (4 + ENDS))
            .map(|r| f64::from(r[g] + r[groups + g] + r[2 * groups + g]))
            .sum();
        assert!((all / f64::from(n) - 1.0).abs() < 0.02, "{albedo}, group {g}: {all}");
    }
}

#[test]
fn paths_have_the_means_of_those_that_are_followed_alone() {
    for albedo in [0.4, 0.97] {
        means::<One>(1, albedo);
        means::<[Lane; 1]>(2, albedo);
    }
}

#[test]
fn numbers_lie_inside_and_depths_stay_in_the_block() {
    for key in (0..2_000_000).map(|i: i32| i.wrapping_mul(GOLDEN)) {
        assert!((f32::MIN_POSITIVE..1.0).contains(&drawn(key)));
    }
    for depth in [0.0, 1e-300, 1e-5, 9.9e-5, 1.1e-4, 1.0, 50.0, 800.0] {
        for u in [1e-10, 0.5, 1.0 - 1e-10] {
            let part = deep(depth, u);
            assert!((0.0..=1.0).contains(&part), "{depth} {u}: {part}");
            assert!(depth > 1e-3 || (part - u).abs() < 1e-4);
        }
    }
}
