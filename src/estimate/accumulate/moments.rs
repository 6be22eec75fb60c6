//! Means and variances from exact sums.

/// Mean, in counts, of `count` cycles of `blanks` blanks each. NaN for no cycle.
pub fn mean(sum: i64, count: u32, blanks: u16) -> f64 {
    // Below 2⁴⁸ (see `Sums`): the conversion is exact.
    #[expect(clippy::cast_precision_loss, reason = "sums stay below 2^48")]
    let sum = sum as f64;
    sum / (f64::from(count) * f64::from(blanks))
}

/// Sample variance (n − 1) in counts², from exact sums. NaN below two cycles, never negative.
pub fn variance(sum: i64, sum_squares: u64, count: u32, blanks: u16) -> f64 {
    if count < 2 {
        return f64::NAN;
    }
    // nΣY² − (ΣY)² is an exact integer below 2⁹⁶: no cancellation, whatever the mean. One rounding, so both ways
    // give the same bits; the short one serves all but the longest campaigns.
    let short = sum_squares.leading_zeros() + count.leading_zeros() >= 33 && sum.unsigned_abs() < 1 << 31;
    #[expect(clippy::cast_precision_loss, reason = "one rounding of the exact result")]
    let spread = if short {
        (u64::from(count) * sum_squares - sum.unsigned_abs() * sum.unsigned_abs()) as f64
    } else {
        (i128::from(count) * i128::from(sum_squares) - i128::from(sum) * i128::from(sum)) as f64
    };
    let b = f64::from(blanks);
    spread / (f64::from(count) * f64::from(count - 1) * (b * b))
}
