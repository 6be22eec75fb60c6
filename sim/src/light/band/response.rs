//! Responses: what a camera makes of light over wavelength, alone or as a product of several curves.
//!
//! Curves are straight between their nodes and 0 outside, by contract; a product is taken exactly on the union of the
//! nodes. Knows neither temperatures nor samples.

use super::BandError;
use crate::light::table::{Table, interpolate};

/// Response below this fraction of its maximum is leak, not band.
const IN_BAND: f64 = 1e-3;
/// Step of the fine grid that sampling is judged on, µm.
const FINE_STEP_UM: f64 = 1e-3;
/// Points inside a piece at which the maximum of a product is looked for.
const INSIDE: u32 = 7;

/// Response of camera, filter and lens over wavelength: photo-electrons per photon, or any multiple of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    curves: Vec<Curve>,
    /// Union of the nodes of the curves where all of them are defined.
    nodes: Vec<f64>,
}

/// Straight between nodes.
#[derive(Debug, Clone, PartialEq)]
struct Curve {
    wavelength_um: Vec<f64>,
    value: Vec<f64>,
}

impl Response {
    /// From ascending wavelengths in µm and values; linear between, 0 outside.
    ///
    /// # Errors
    ///
    /// [`BandError`] unless wavelengths ascend above 0 and values are finite, not negative, not all 0.
    pub fn new(wavelength_um: Vec<f64>, response: Vec<f64>) -> Result<Self, BandError> {
        let bad = |what: String| Err(BandError::Response(what));
        if wavelength_um.len() != response.len() || wavelength_um.len() < 2 {
            return bad(format!("{} wavelengths, {} values", wavelength_um.len(), response.len()));
        }
        let rising = |pair: &&[f64]| pair[0] > 0.0 && pair[1] > pair[0] && pair[1].is_finite();
        if let Some(pair) = wavelength_um.windows(2).find(|pair| !rising(pair)) {
            return bad(format!("wavelengths {} and {} um do not ascend", pair[0], pair[1]));
        }
        if let Some(value) = response.iter().find(|r| !(**r >= 0.0 && r.is_finite())) {
            return bad(format!("{value}"));
        }
        if response.iter().all(|&r| r == 0.0) {
            return bad("all are 0".to_owned());
        }
        let nodes = wavelength_um.clone();
        Ok(Self { curves: vec![Curve { wavelength_um, value: response }], nodes })
    }

    /// From a table with the columns wavelength_um and response.
    ///
    /// # Errors
    ///
    /// [`BandError`] as [`Response::new`], or when the table cannot be read.
    pub fn from_csv(text: &str) -> Result<Self, BandError> {
        let table = Table::parse(text)?;
        Self::new(table.ascending("wavelength_um")?.to_vec(), table.column("response")?.to_vec())
    }

    /// Product of columns of the shipped table of assumed detectors, filters and lens (`sim/data/optics`,
    /// `detector_filter_model.csv`, 2.5–6 µm): for example `QE_InSb_model`, `filter_3.40_fwhm0.12`,
    /// `lens_transmission_model`. Row by row, and linear between the rows. Placeholders, not measurements.
    ///
    /// # Errors
    ///
    /// [`BandError::Table`] naming the columns there are.
    pub fn shipped(columns: &[&str]) -> Result<Self, BandError> {
        let table = Table::parse(include_str!("../../../data/optics/detector_filter_model.csv"))?;
        let wavelength_um = table.ascending("wavelength_um")?.to_vec();
        let mut response = vec![1.0; wavelength_um.len()];
        for name in columns {
            for (product, factor) in response.iter_mut().zip(table.column(name)?) {
                *product *= factor;
            }
        }
        Self::new(wavelength_um, response)
    }

    /// The shipped InSb camera with lens and the 3.40 µm filter of 0.12 µm width (all assumed).
    ///
    /// # Errors
    ///
    /// None in practice: the table is shipped and read by a test.
    pub fn filtered_insb() -> Result<Self, BandError> {
        Self::shipped(&["QE_InSb_model", "filter_3.40_fwhm0.12", "lens_transmission_model"])
    }

    /// Product of responses on their own grids (filter × detector × lens × air …): the exact product of straight
    /// pieces on the union of the nodes, 0 where one of them is not defined.
    ///
    /// # Errors
    ///
    /// [`BandError::Response`] when there is none, or they have nothing in common.
    pub fn product(factors: &[Self]) -> Result<Self, BandError> {
        let nothing = || BandError::Response("the product of the curves is 0 everywhere".to_owned());
        let curves: Vec<Curve> = factors.iter().flat_map(|factor| factor.curves.iter().cloned()).collect();
        let from = factors.iter().map(|f| f.range_um()[0]).fold(0.0, f64::max);
        let to = factors.iter().map(|f| f.range_um()[1]).fold(f64::INFINITY, f64::min);
        if curves.is_empty() || from >= to {
            return Err(nothing());
        }
        let inside = |um: &&f64| (from..=to).contains(*um);
        let mut nodes: Vec<f64> =
            curves.iter().flat_map(|c| c.wavelength_um.iter().filter(inside)).copied().collect();
        nodes.sort_by(f64::total_cmp);
        nodes.dedup_by(|a, b| a.to_bits() == b.to_bits());
        let product = Self { curves, nodes };
        // Inside a piece the product is 0 only if one of the factors is 0 all along it.
        let lit = product.nodes.windows(2).any(|piece| product.at(0.5 * (piece[0] + piece[1])) > 0.0);
        if lit { Ok(product) } else { Err(nothing()) }
    }

    /// Value at a wavelength in µm: linear between nodes (a product of such), 0 outside the table.
    pub fn at(&self, wavelength_um: f64) -> f64 {
        let [from, to] = self.range_um();
        if !(from..=to).contains(&wavelength_um) {
            return 0.0;
        }
        self.curves
            .iter()
            .map(|curve| interpolate(&curve.wavelength_um, &curve.value, wavelength_um))
            .product()
    }

    /// First and last wavelength of the table, µm.
    pub fn range_um(&self) -> [f64; 2] {
        [self.nodes[0], self.nodes[self.nodes.len() - 1]]
    }

    /// Wavelengths between which the response is one polynomial, µm, ascending.
    pub fn nodes_um(&self) -> &[f64] {
        &self.nodes
    }

    /// Degree of those polynomials: the number of curves multiplied.
    pub(super) fn degree(&self) -> usize {
        self.curves.len()
    }

    /// The connected stretch about the maximum where the response is at least a thousandth of it, µm.
    pub fn in_band_um(&self) -> [f64; 2] {
        let outline = self.outline();
        let top = (0..outline.len()).fold(0, |top, i| if outline[i].1 > outline[top].1 { i } else { top });
        let limit = IN_BAND * outline[top].1;
        let below = (0..top).rev().find(|&i| outline[i].1 < limit);
        let above = (top + 1..outline.len()).find(|&i| outline[i].1 < limit);
        let [from, to] = self.range_um();
        [
            below.map_or(from, |i| self.crossing(outline[i + 1], outline[i], limit)),
            above.map_or(to, |i| self.crossing(outline[i - 1], outline[i], limit)),
        ]
    }

    /// Largest value of the response (of a product: on a grid eight times as fine as its nodes).
    pub(super) fn maximum(&self) -> f64 {
        self.outline().iter().map(|point| point.1).fold(0.0, f64::max)
    }

    /// Points that show where the response is high and low.
    fn outline(&self) -> Vec<(f64, f64)> {
        if self.degree() == 1 {
            let curve = &self.curves[0];
            return curve.wavelength_um.iter().copied().zip(curve.value.iter().copied()).collect();
        }
        let mut points = Vec::new();
        for piece in self.nodes.windows(2) {
            for step in 0..=INSIDE {
                points.push(piece[0] + (piece[1] - piece[0]) * f64::from(step) / f64::from(INSIDE + 1));
            }
        }
        points.push(self.range_um()[1]);
        points.into_iter().map(|um| (um, self.at(um))).collect()
    }

    /// Where the response passes `limit` between a point at or above it and one below.
    fn crossing(&self, inside: (f64, f64), outside: (f64, f64), limit: f64) -> f64 {
        if self.degree() == 1 {
            let ((a, high), (b, low)) = (inside, outside);
            return a + (b - a) * ((high - limit) / (high - low)).clamp(0.0, 1.0);
        }
        let (mut a, mut b) = (inside.0, outside.0);
        for _ in 0..60 {
            let middle = 0.5 * (a + b);
            if self.at(middle) >= limit { a = middle } else { b = middle }
        }
        a
    }

    /// ∫ response · f dλ over [from, to] with steps of 1 nm at most, as (λ, response Δλ) pairs: midpoint rule on
    /// pieces that end at the nodes, so that the straight pieces of the response integrate exactly.
    pub(super) fn fine(&self, from: f64, to: f64) -> Vec<(f64, f64)> {
        let mut points = Vec::new();
        let (mut low, mut node) = (from, self.nodes.partition_point(|&um| um <= from));
        while low < to {
            let high = self.nodes.get(node).copied().unwrap_or(to).min(to);
            let pieces = ((high - low) / FINE_STEP_UM).ceil().clamp(1.0, FINE_PIECES_MAX);
            let step = (high - low) / pieces;
            let mut piece = 0.0;
            while piece < pieces {
                let um = low + (piece + 0.5) * step;
                points.push((um, self.at(um) * step));
                piece += 1.0;
            }
            low = high;
            node += 1;
        }
        points
    }

    /// The fine grid over the whole table.
    pub(super) fn fine_whole(&self) -> Vec<(f64, f64)> {
        let [from, to] = self.range_um();
        self.fine(from, to)
    }

    /// The fine grid of what is outside the band.
    pub(super) fn fine_outside(&self) -> Vec<(f64, f64)> {
        let ([from, to], [low, high]) = (self.range_um(), self.in_band_um());
        let mut points = self.fine(from, low);
        points.extend(self.fine(high, to));
        points
    }
}

/// Most steps of the fine grid on one piece: a response given up to 1 m stays computable.
const FINE_PIECES_MAX: f64 = 20_000.0;

#[cfg(test)]
mod tests {
    use super::*;

    fn csv(rows: &[(f64, f64)]) -> Response {
        let (um, value) = rows.iter().copied().unzip();
        Response::new(um, value).unwrap()
    }

    #[test]
    fn impossible_responses_are_refused() {
        for text in
            ["", "wavelength_um,response\n3,1\n", "wavelength_um,response\n3,0\n4,0\n", "a,b\n1,2\n2,3\n"]
        {
            assert!(Response::from_csv(text).is_err(), "{text}");
        }
        assert!(Response::from_csv("wavelength_um,response\n3,1\n4,-1\n").is_err());
        assert!(Response::from_csv("wavelength_um,response\n3,1\n4,NaN\n").is_err());
        assert!(Response::from_csv("wavelength_um,response\n3,1\ninf,1\n").is_err());
        let flat = Response::from_csv("wavelength_um,response\n3,1\n4,1\n").unwrap();
        assert_eq!(flat.in_band_um().map(f64::to_bits), [3.0, 4.0].map(f64::to_bits));
    }

    #[test]
    fn a_product_is_taken_exactly_on_the_union_of_the_nodes() {
        // Two ramps that are 0 at each other's end: 0 at every node, a parabola between.
        let up = csv(&[(3.0, 0.0), (5.0, 1.0)]);
        let down = csv(&[(3.0, 1.0), (4.9, 0.05), (6.0, 0.05)]);
        let both = Response::product(&[up.clone(), down.clone()]).unwrap();
        for um in [3.1, 3.7, 4.6, 4.95, 5.0] {
            assert!((both.at(um) - up.at(um) * down.at(um)).abs() < 1e-16, "{um}");
        }
        assert!(both.at(5.5) == 0.0 && both.degree() == 2);
        assert_eq!(both.nodes_um().len(), 3);
        let [low, high] = both.in_band_um();
        // up·down = (u/2)(1 − u/2) with u = λ − 3: maximum 1/4; a thousandth of it at u = 5.0e-4.
        assert!((low - 3.0 - 5.0e-4).abs() < 2e-6 && (high - 5.0).abs() < 1e-15, "{low} {high}");
        // Curves without a common wavelength, or whose supports do not meet.
        assert!(Response::product(&[up.clone(), csv(&[(7.0, 1.0), (8.0, 1.0)])]).is_err());
        let early = csv(&[(3.0, 1.0), (3.5, 0.0), (5.0, 0.0)]);
        let late = csv(&[(3.0, 0.0), (4.0, 0.0), (5.0, 1.0)]);
        assert!(Response::product(&[early, late]).is_err() && Response::product(&[]).is_err());
    }
}
