//! Sums against plain loops: any order, any number of cycles at a time, any width.

use super::*;

/// Noise over all counts of a camera of so many bits.
fn noise(seed: u64, pixels: usize, bits: u32) -> Vec<u16> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    (0..pixels)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            u16::try_from(state >> (64 - bits)).unwrap()
        })
        .collect()
}

fn frame(seed: u64, pixels: usize) -> Vec<u16> {
    noise(seed, pixels, 14)
}

fn slow(cycles: &[(Vec<Vec<u16>>, Vec<u16>)], pixel: usize, saturation: u16) -> (i64, u64, u64, u32) {
    let mut out = (0, 0, 0, 0);
    for (blanks, spray) in cycles {
        if spray[pixel] >= saturation || blanks.iter().any(|b| b[pixel] >= saturation) {
            continue;
        }
        let total: i64 = blanks.iter().map(|b| i64::from(b[pixel])).sum();
        let y = i64::try_from(blanks.len()).unwrap() * i64::from(spray[pixel]) - total;
        out.0 += y;
        out.1 += u64::try_from(y * y).unwrap();
        out.2 += u64::try_from(total).unwrap();
        out.3 += 1;
    }
    out
}

fn add(sums: &mut Sums, cycle: &(Vec<Vec<u16>>, Vec<u16>)) {
    let blanks: Vec<&[u16]> = cycle.0.iter().map(Vec::as_slice).collect();
    sums.add_cycle(0, &blanks, &cycle.1).unwrap();
}

/// Against a plain loop, for one and for several blanks, in any order, merged, and after taking one out.
#[test]
fn sums_are_exact_in_any_order() {
    for blanks in [1_u16, 3] {
        let (rows, columns, saturation) = (7, 1301, 15_000);
        let cycles: Vec<_> = (0..6_u64)
            .map(|c| {
                let dark = (0..u64::from(blanks)).map(|b| frame(100 * c + b + 1, rows * columns)).collect();
                (dark, frame(1000 + c, rows * columns))
            })
            .collect();
        let mut forward = Sums::new(1, rows, columns, blanks, saturation).unwrap();
        let mut other = forward.clone();
        let mut part = forward.clone();
        cycles.iter().for_each(|c| add(&mut forward, c));
        cycles[..2].iter().rev().for_each(|c| add(&mut other, c));
        cycles[2..].iter().for_each(|c| add(&mut part, c));
        other.merge(&part).unwrap();
        assert!(forward == other);
        let mut together = Sums::new(1, rows, columns, blanks, saturation).unwrap();
        let dark: Vec<Vec<&[u16]>> =
            cycles.iter().map(|(dark, _)| dark.iter().map(Vec::as_slice).collect()).collect();
        let all: Vec<Cycle<'_>> =
            dark.iter().zip(&cycles).map(|(blanks, (_, spray))| Cycle { blanks, spray }).collect();
        together.add_cycles(0, &all).unwrap();
        assert!(forward == together);
        for pixel in [0, 5, 8191, 8192, rows * columns - 1] {
            let level = &forward.levels()[0];
            let got =
                (level.sum(pixel), level.sum_squares(pixel), level.sum_blanks(pixel), level.count(pixel));
            assert_eq!(got, slow(&cycles, pixel, saturation));
            assert_eq!(level.saturated(pixel), 6 - level.count(pixel));
        }
        let dark: Vec<&[u16]> = cycles[0].0.iter().map(Vec::as_slice).collect();
        forward.remove_cycle(0, &dark, &cycles[0].1).unwrap();
        let mut without = Sums::new(1, rows, columns, blanks, saturation).unwrap();
        cycles[1..].iter().for_each(|c| add(&mut without, c));
        assert!(forward == without);
    }
}

/// Any number of cycles at a time, of 14 bits up to the highest count or of 16: the sums of a plain loop.
#[test]
fn groups_of_cycles_are_exact() {
    let pixels = 2600;
    for (bits, saturation) in [(14, 16_384), (14, 16_383), (14, 1), (16, 65_535), (16, 16_385)] {
        let all: Vec<_> = (0..9_u64)
            .map(|c| {
                let (mut blank, mut spray) = (noise(2 * c + 1, pixels, bits), noise(2 * c + 2, pixels, bits));
                // The largest differences of both signs.
                (blank[7], spray[7], blank[8], spray[8]) = (0, saturation - 1, saturation - 1, 0);
                (vec![blank], spray)
            })
            .collect();
        for n in 1..=all.len() {
            let dark: Vec<Vec<&[u16]>> =
                all[..n].iter().map(|(dark, _)| dark.iter().map(Vec::as_slice).collect()).collect();
            let cycles: Vec<Cycle<'_>> =
                dark.iter().zip(&all).map(|(blanks, (_, spray))| Cycle { blanks, spray }).collect();
            let mut sums = Sums::new(1, 1, pixels, 1, saturation).unwrap();
            // Memory that was used before holds nothing after.
            sums.add_cycles(0, &cycles[n / 2..]).unwrap();
            sums.clear();
            assert_eq!((sums.levels()[0].sum(7), sums.levels()[0].count(7)), (0, 0));
            sums.add_cycles(0, &cycles).unwrap();
            let level = &sums.levels()[0];
            for pixel in (0..pixels).step_by(13).chain([7, 8, pixels - 1]) {
                let got =
                    (level.sum(pixel), level.sum_squares(pixel), level.sum_blanks(pixel), level.count(pixel));
                assert_eq!(got, slow(&all[..n], pixel, saturation), "{bits} {saturation} {n} {pixel}");
            }
        }
    }
}

/// Sums that outgrow short numbers are those of narrow ones: sixteen cycles of the highest 14 bit samples.
#[test]
fn short_sums_widen_without_a_trace() {
    let saturation = 1 << 14;
    let (high, low) = ([16_383_u16, 7, 16_384], [0_u16; 3]);
    let last = Samples { blanks: 1, saturation }.short_max();
    assert_eq!(last, 16);
    let sums = |cycles: u32| {
        let mut sums = Sums::new(1, 1, 3, 1, saturation).unwrap();
        (0..cycles).for_each(|_| sums.add_cycle(0, &[&high], &low).unwrap());
        sums
    };
    let (short, mut narrow) = (sums(last), sums(last + 1));
    assert!(matches!(short.levels[0].cells, Cells::Short(_)));
    assert!(matches!(narrow.levels[0].cells, Cells::Narrow(_)));
    for (sums, cycles) in [(&short, last), (&narrow, last + 1)] {
        let level = &sums.levels()[0];
        assert_eq!(level.sum_squares(0), u64::from(cycles) * 16_383 * 16_383);
        assert_eq!((level.sum(0), level.sum(2)), (-i64::from(cycles) * 16_383, 0));
    }
    let (mut one, mut both) = (sums(1), narrow.clone());
    one.merge(&short).unwrap();
    assert!(one == narrow);
    both.merge(&short).unwrap();
    one.merge(&narrow).unwrap();
    assert!(both == sums(2 * last + 1) && one == sums(2 * last + 2));
    narrow.remove_cycle(0, &[&high], &low).unwrap();
    assert!(narrow == short);
    narrow.remove_sample(0, 0, &[&high], &low);
    assert_eq!(narrow.levels()[0].sum_squares(0), u64::from(last - 1) * 16_383 * 16_383);
    // What does not fit even once is narrow from the start.
    assert_eq!(Samples { blanks: 2, saturation: u16::MAX }.short_max(), 0);
    assert!(matches!(Sums::new(1, 1, 3, 2, u16::MAX).unwrap().levels[0].cells, Cells::Narrow(_)));
}

/// Sums that outgrow narrow numbers are those of wide ones: added, merged and taken out.
#[test]
fn sums_widen_without_a_trace() {
    let (high, low) = ([65_534_u16; 3], [0_u16; 3]);
    let blanks = vec![high.as_slice(); usize::from(BLANKS_MAX)];
    let last = Samples { blanks: BLANKS_MAX, saturation: u16::MAX }.narrow_max();
    let sums = |cycles: u32| {
        let mut sums = Sums::new(1, 1, 3, BLANKS_MAX, u16::MAX).unwrap();
        (0..cycles).for_each(|_| sums.add_cycle(0, &blanks, &low).unwrap());
        sums
    };
    let (narrow, mut wide) = (sums(last), sums(last + 1));
    assert!(matches!(narrow.levels[0].cells, Cells::Narrow(_)));
    assert!(matches!(wide.levels[0].cells, Cells::Wide(_)));
    for (sums, cycles) in [(&narrow, last), (&wide, last + 1)] {
        let level = &sums.levels()[0];
        assert_eq!(level.sum(1), -i64::from(cycles) * 256 * 65_534);
        assert_eq!(level.sum_blanks(2), u64::from(cycles) * 256 * 65_534);
    }
    let mut merged = sums(1);
    merged.merge(&narrow).unwrap();
    assert!(merged == wide);
    wide.remove_cycle(0, &blanks, &low).unwrap();
    assert!(wide == narrow);
    wide.merge(&narrow).unwrap();
    assert!(wide == sums(2 * last));
    wide.remove_sample(0, 1, &blanks, &low);
    assert_eq!(wide.levels()[0].count(1), 2 * last - 1);
    assert_eq!(wide.levels()[0].sum(1), -i64::from(2 * last - 1) * 256 * 65_534);
    assert!(wide != sums(2 * last));
}

#[test]
fn extreme_counts_do_not_overflow() {
    let mut sums = Sums::new(1, 1, 2, BLANKS_MAX, u16::MAX).unwrap();
    let high = [65_534_u16, 0];
    let low = [0_u16, 65_534];
    let blanks = vec![low.as_slice(); usize::from(BLANKS_MAX)];
    for _ in 0..1000 {
        sums.add_cycle(0, &blanks, &high).unwrap();
    }
    let level = &sums.levels()[0];
    assert_eq!(level.sum(0), 1000 * 256 * 65_534);
    assert_eq!(level.sum(1), -1000 * 256 * 65_534);
    assert!(mean(level.sum(1), 1000, BLANKS_MAX).to_bits() == (-65_534.0_f64).to_bits());
    assert!(variance(level.sum(1), level.sum_squares(1), 1000, BLANKS_MAX).to_bits() == 0.0_f64.to_bits());
    assert!(sums.cycles_max() >= 65_536);
}

#[test]
fn wrong_cycles_are_refused() {
    let mut sums = Sums::new(2, 1, 2, 2, 16_383).unwrap();
    let f = [1_u16, 2];
    assert_eq!(sums.add_cycle(0, &[&f], &f), Err(AccumulateError::Blanks { given: 1, expected: 2 }));
    assert_eq!(sums.add_cycle(0, &[&f, &f], &f[..1]), Err(AccumulateError::Pixels { given: 1, expected: 2 }));
    assert_eq!(sums.add_cycle(2, &[&f, &f], &f), Err(AccumulateError::Level { level: 2, levels: 2 }));
    assert_eq!(sums.remove_cycle(0, &[&f, &f], &f), Err(AccumulateError::Empty { level: 0 }));
    assert_eq!(Sums::new(1, 1, 1, 0, 1), Err(AccumulateError::BlanksPerCycle { blanks: 0 }));
    let unlike = Sums::new(2, 1, 2, 3, 16_383).unwrap();
    assert_eq!(sums.merge(&unlike), Err(AccumulateError::Unlike));
    let full = sums.cycles_max();
    sums.levels[1].cycles = full;
    assert_eq!(sums.add_cycle(1, &[&f, &f], &f), Err(AccumulateError::Full { level: 1, cycles: full }));
}
