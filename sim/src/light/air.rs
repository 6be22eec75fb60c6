//! The laboratory's air between window and camera.
//!
//! Water vapour and carbon dioxide absorb part of 2.5–6 µm even over a metre. What is shipped is a band model (LOWTRAN7)
//! made for kilometres: an upper estimate of the absorption over a metre. In a campaign it cancels if the calibration
//! uses the same path.

use super::names;
use super::provenance::Provenance;
use super::table::{Table, TableError, interpolate};
use std::sync::LazyLock;

/// Longest path in metres: the table ends at 2 m.
pub const LENGTH_MAX_M: f64 = 10.0;

/// Composition and pressure of the air.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Atmosphere {
    /// US standard 1976 at sea level: 288 K, moderately humid.
    UsStandard,
    /// Mid-latitude summer at sea level: 294 K, humid.
    MidlatitudeSummer,
    /// Mid-latitude winter at sea level: 272 K, dry.
    MidlatitudeWinter,
}

impl Atmosphere {
    /// All of them with their words and the columns of the table at 1 m.
    pub const ALL: [(Self, &str, &str); 3] = [
        (Self::UsStandard, "us-standard", "T_1m_us_standard"),
        (Self::MidlatitudeSummer, "midlatitude-summer", "T_1m_midlat_summer"),
        (Self::MidlatitudeWinter, "midlatitude-winter", "T_1m_midlat_winter"),
    ];

    /// The atmosphere of a configuration's word.
    ///
    /// # Errors
    ///
    /// [`AirError::Unknown`] with the words there are.
    pub fn named(name: &str) -> Result<Self, AirError> {
        let found = Self::ALL.iter().find(|own| own.1.eq_ignore_ascii_case(name));
        found.map(|own| own.0).ok_or_else(|| AirError::Unknown { name: name.to_owned() })
    }
}

/// Why there is no such path.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AirError {
    /// The atmosphere is not known.
    #[error(
        "atmosphere `{name}` is not known{}; there are {}",
        names::guessed(name, &Atmosphere::ALL.map(|own| own.1)),
        Atmosphere::ALL.map(|own| own.1).join(", ")
    )]
    Unknown {
        /// The name asked for.
        name: String,
    },
    /// The path is impossible or longer than the table reaches.
    #[error("a path of {length_m} m through the air: it must be from 0 to {LENGTH_MAX_M} m")]
    Length {
        /// The length asked for, in m.
        length_m: f64,
    },
}

/// A horizontal path through the air at sea level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AirPath {
    atmosphere: Atmosphere,
    length_m: f64,
}

struct Shipped {
    um: Vec<f64>,
    /// ln(−ln T) at 1 m for each of [`Atmosphere::ALL`].
    ln_depth: [Vec<f64>; 3],
    /// Exponents of the optical depth's growth with length below and above 1 m.
    exponents: [Vec<f64>; 2],
    provenance: Provenance,
}

static SHIPPED: LazyLock<Shipped> =
    LazyLock::new(|| Shipped::parse().expect("the shipped table is read by a test"));

impl Shipped {
    fn parse() -> Result<Self, TableError> {
        let table = Table::parse(include_str!("../../data/optics/air_transmittance_lowtran7.csv"))?;
        let ln_depth = |column: &str| -> Result<Vec<f64>, TableError> {
            let t = table.possible(column, "above 0 and below 1", |t| t > 0.0 && t < 1.0)?;
            Ok(t.iter().map(|t| (-t.ln()).ln()).collect())
        };
        let [standard, summer, winter] = Atmosphere::ALL.map(|own| ln_depth(own.2));
        let standard = standard?;
        let (half, twice) = (ln_depth("T_0.5m_us_standard")?, ln_depth("T_2m_us_standard")?);
        let growth = |long: &[f64], short: &[f64]| -> Vec<f64> {
            long.iter().zip(short).map(|(l, s)| (l - s) / std::f64::consts::LN_2).collect()
        };
        Ok(Self {
            um: table.wavelengths_um()?,
            exponents: [growth(&standard, &half), growth(&twice, &standard)],
            ln_depth: [standard, summer?, winter?],
            provenance: table.provenance().clone(),
        })
    }
}

/// Where the numbers come from.
pub fn provenance() -> &'static Provenance {
    &SHIPPED.provenance
}

/// Range of the table in µm; outside it the ends are used.
pub fn range_um() -> [f64; 2] {
    [SHIPPED.um[0], SHIPPED.um[SHIPPED.um.len() - 1]]
}

impl AirPath {
    /// A path of this length in metres.
    ///
    /// # Errors
    ///
    /// [`AirError::Length`] unless it is from 0 to [`LENGTH_MAX_M`].
    pub fn new(atmosphere: Atmosphere, length_m: f64) -> Result<Self, AirError> {
        if (0.0..=LENGTH_MAX_M).contains(&length_m) {
            Ok(Self { atmosphere, length_m })
        } else {
            Err(AirError::Length { length_m })
        }
    }

    /// Transmittance at a wavelength in µm, in [0, 1].
    ///
    /// A band of many lines is not exponential in the length: −ln T grows as a power of it (0.55 to 0.67), which is
    /// taken from the columns at 0.5, 1 and 2 m of the US standard atmosphere and goes on beyond them; the other
    /// atmospheres, known at 1 m, grow alike. The power law foretells the column at 2 m from those at 0.5 and 1 m
    /// within 0.0011 in T, where Beer's law errs by 0.11. Below 0.5 m it overstates the absorption: there single
    /// lines become exponential.
    pub fn transmittance(&self, wavelength_um: f64) -> f64 {
        (-self.depth(wavelength_um)).exp()
    }

    /// Emissivity of the path, 1 − T: the air radiates at its own temperature, that of the lab.
    pub fn emissivity(&self, wavelength_um: f64) -> f64 {
        -(-self.depth(wavelength_um)).exp_m1()
    }

    /// Wavelengths in µm and transmittances at the nodes of the table, ascending; the ends go on to 0.1 and 1000 µm.
    pub fn curve(&self) -> (Vec<f64>, Vec<f64>) {
        let um: Vec<f64> = [0.1].iter().chain(&SHIPPED.um).chain(&[1000.0]).copied().collect();
        let transmittance = um.iter().map(|um| self.transmittance(*um)).collect();
        (um, transmittance)
    }

    /// −ln T.
    fn depth(&self, wavelength_um: f64) -> f64 {
        if self.length_m <= 0.0 {
            return 0.0;
        }
        let shipped = &*SHIPPED;
        let at = |column: &[f64]| interpolate(&shipped.um, column, wavelength_um);
        let exponent = at(&shipped.exponents[usize::from(self.length_m > 1.0)]);
        (at(&shipped.ln_depth[self.atmosphere as usize]) + exponent * self.length_m.ln()).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(atmosphere: Atmosphere, length_m: f64) -> AirPath {
        AirPath::new(atmosphere, length_m).unwrap()
    }

    fn table() -> Table {
        Table::parse(include_str!("../../data/optics/air_transmittance_lowtran7.csv")).unwrap()
    }

    #[test]
    fn every_column_of_the_table_comes_back() {
        let (table, um) = (table(), table().wavelengths_um().unwrap());
        let mut columns: Vec<(AirPath, &str)> =
            Atmosphere::ALL.iter().map(|own| (path(own.0, 1.0), own.2)).collect();
        columns.push((path(Atmosphere::UsStandard, 0.5), "T_0.5m_us_standard"));
        columns.push((path(Atmosphere::UsStandard, 2.0), "T_2m_us_standard"));
        for (path, name) in columns {
            for (um, wanted) in um.iter().zip(table.column(name).unwrap()) {
                let (found, kept) = (path.transmittance(*um), path.emissivity(*um));
                assert!((found - wanted).abs() < 1e-13, "{name} {um} um: {found} {wanted}");
                assert!((found + kept - 1.0).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn a_power_of_the_length_foretells_columns_that_it_has_not_seen() {
        // Each column of the US standard from the two others, by the law that `depth` uses: ln(−ln T) straight in ln L.
        let table = table();
        let column = |name: &str| -> Vec<f64> {
            table.column(&format!("T_{name}m_us_standard")).unwrap().iter().map(|t| -t.ln()).collect()
        };
        let (half, one, two) = (column("0.5"), column("1"), column("2"));
        let (mut worst, mut beer) = ([0.0f64; 3], 0.0f64);
        for i in 0..one.len() {
            let t = |depth: f64| (-depth).exp();
            worst[0] = worst[0].max((t(one[i] * one[i] / two[i]) - t(half[i])).abs());
            worst[1] = worst[1].max((t((half[i] * two[i]).sqrt()) - t(one[i])).abs());
            worst[2] = worst[2].max((t(one[i] * one[i] / half[i]) - t(two[i])).abs());
            beer = beer.max((t(2.0 * one[i]) - t(two[i])).abs());
        }
        // The figures of the docs, rounded up; a law that is not that of the table misses by 0.1, as Beer's does.
        assert!(worst[0] < 7e-4 && worst[1] < 5e-4 && worst[2] < 1.1e-3, "{worst:?}");
        assert!(beer > 0.1, "{beer}");
    }

    #[test]
    fn longer_and_more_humid_paths_absorb_more() {
        for um in [2.4, 2.7, 3.0, 3.4, 4.26, 5.5, 7.0] {
            let mut before = 1.0;
            for length in [0.0, 1e-6, 0.1, 0.5, 0.999, 1.0, 1.001, 2.0, 5.0, 10.0] {
                let t = path(Atmosphere::UsStandard, length).transmittance(um);
                assert!(t.is_finite() && t <= before && t >= 0.0, "{um} um {length} m: {t}");
                before = t;
            }
            assert_eq!(path(Atmosphere::UsStandard, 0.0).transmittance(um).to_bits(), 1f64.to_bits());
        }
        // In water's band at 2.7 um summer's air absorbs more than winter's.
        let at = |atmosphere| path(atmosphere, 1.0).transmittance(2.7);
        assert!(at(Atmosphere::MidlatitudeSummer) < at(Atmosphere::UsStandard));
        assert!(at(Atmosphere::UsStandard) < at(Atmosphere::MidlatitudeWinter));
        // optics.md: 0.990 to 0.995 over 1 m in the filter's inner band.
        assert!((0.985..0.996).contains(&path(Atmosphere::UsStandard, 1.0).transmittance(3.4)));
        for length in [-1.0, f64::NAN, 10.1, f64::INFINITY] {
            assert!(matches!(AirPath::new(Atmosphere::UsStandard, length), Err(AirError::Length { .. })));
        }
        assert_eq!(Atmosphere::named("US-standard"), Ok(Atmosphere::UsStandard));
        assert!(Atmosphere::named("midlatitude-sumer").unwrap_err().to_string().contains("did you mean"));
        assert!(provenance().status.is_some() && range_um()[0] < 2.51);
    }
}
