//! The exact cumulative distribution of the scattering angle.

use super::amplitudes::{Direction, Terms};
use super::lengths::series_length;
use super::series::efficiencies;
use super::{MieError, Sphere};
use crate::light::quadrature::gauss_legendre_unit;

/// Largest size parameter: the work grows as x² per angle.
const SIZE_CUMULATIVE: f64 = 2e4;

/// ½∫ p₁₁ dμ from cos θ to 1, for directions in any order.
///
/// p₁₁ is a polynomial in μ of twice the length of the series, so Gauss–Legendre with one node per order (and one
/// more) is exact: error below 1e-12. NaN when the sphere scatters nothing.
///
/// # Errors
///
/// As [`super::efficiencies`], with a lower limit of 2e4 for x.
pub fn cumulative(sphere: Sphere, directions: &[Direction]) -> Result<Vec<f64>, MieError> {
    let Sphere { size_parameter, n, k } = sphere.checked()?;
    if size_parameter > SIZE_CUMULATIVE {
        let inside = size_parameter * n.hypot(k);
        return Err(MieError::TooLarge { size_parameter, inside, limit: SIZE_CUMULATIVE });
    }
    let q_sca = efficiencies(size_parameter, n, k)?.q_sca;
    let norm = 1.0 / (size_parameter * size_parameter * q_sca);
    let terms = Terms::new(sphere);
    debug_assert!(terms.len() as f64 <= series_length(size_parameter), "one node per order is enough");
    let rule = gauss_legendre_unit(terms.len() + 1);
    Ok(directions
        .iter()
        .map(|direction| {
            let end = direction.versine();
            let towards: Vec<Direction> =
                rule.iter().map(|&(node, _)| Direction::from_versine(end * node)).collect();
            let sum: f64 = rule
                .iter()
                .zip(terms.towards(&towards))
                .map(|(&(_, weight), (s1, s2))| weight * (s1.norm_sqr() + s2.norm_sqr()))
                .sum();
            norm * end * sum
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cumulative_distributions_agree_with_the_multiprecision_table() {
        let text = include_str!("../../../tests/data/light/mie_phase_cdf.csv");
        let rows: Vec<Vec<f64>> = text
            .lines()
            .skip(1)
            .map(|line| line.split(',').skip(1).map(|field| field.parse().unwrap()).collect())
            .collect();
        let mut worst = 0.0f64;
        for sphere_rows in rows.chunk_by(|p, q| p[..3] == q[..3]) {
            let sphere =
                Sphere { size_parameter: sphere_rows[0][0], n: sphere_rows[0][1], k: sphere_rows[0][2] };
            let directions: Vec<Direction> =
                sphere_rows.iter().map(|row| Direction::from_degrees(row[3]).unwrap()).collect();
            for (row, found) in sphere_rows.iter().zip(cumulative(sphere, &directions).unwrap()) {
                worst = worst.max((found - row[4]).abs());
                assert!(
                    (found - row[4]).abs() <= 1e-12,
                    "{sphere:?} {} deg: {found} against {}",
                    row[3],
                    row[4]
                );
            }
        }
        println!("worst {worst:e}");
    }

    #[test]
    fn spheres_too_large_for_it_are_refused() {
        let sphere = Sphere { size_parameter: 3e4, n: 1.4, k: 0.0 };
        assert!(matches!(
            cumulative(sphere, &[Direction::from_versine(1.0)]),
            Err(MieError::TooLarge { .. })
        ));
    }
}
