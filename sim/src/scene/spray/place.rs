//! Where jets are in space, and how a place is seen from a jet.

/// A unit vector and two more to the side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub(super) along: [f64; 3],
    pub(super) side: [f64; 3],
    pub(super) other: [f64; 3],
}

impl Frame {
    /// About a direction; `side` is the part of x across it, of y for a direction along x.
    pub(super) fn about(direction: [f64; 3]) -> Self {
        let along = unit(direction);
        let towards = if along[0].abs() > 0.999_999 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
        let part = dot(towards, along);
        let side = unit(std::array::from_fn(|a| towards[a] - part * along[a]));
        Self { along, side, other: cross(along, side) }
    }

    /// `s` along, and aside at an angle in rad.
    pub(super) fn point(&self, from: [f64; 3], s: f64, aside: f64, angle: f64) -> [f64; 3] {
        let (sine, cosine) = angle.sin_cos();
        std::array::from_fn(|a| {
            from[a] + s * self.along[a] + aside * (cosine * self.side[a] + sine * self.other[a])
        })
    }
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    v.map(|x| x / length)
}

/// Where the jets are.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Place {
    /// One round jet per hole: its exit and frame.
    Holes(Vec<([f64; 3], Frame)>),
    /// A conical sheet about an axis.
    Cone { tip_m: [f64; 3], frame: Frame, ring_m: f64, half_angle: f64 },
}

impl Place {
    /// Number of jets.
    pub(super) fn jets(&self) -> usize {
        match self {
            Self::Holes(holes) => holes.len(),
            Self::Cone { .. } => 1,
        }
    }

    /// The point of jet `jet` at `s` along it, `aside` from its middle, at an angle about it in rad. Of a sheet the
    /// middle is the sheet's, aside is across it (negative: towards the axis).
    pub(super) fn point(&self, jet: usize, s: f64, aside: f64, angle: f64) -> [f64; 3] {
        match self {
            Self::Holes(holes) => holes[jet].1.point(holes[jet].0, s, aside, angle),
            Self::Cone { tip_m, frame, ring_m, half_angle } => {
                let (sine, cosine) = half_angle.sin_cos();
                let radius = ring_m + s * sine + aside * cosine;
                frame.point(*tip_m, s * cosine - aside * sine, radius, angle)
            }
        }
    }

    /// (s, distance from the middle) of a place as seen from jet `jet`, and for a hole the direction of the distance.
    pub(super) fn seen(&self, jet: usize, at: [f64; 3]) -> (f64, f64, [f64; 2]) {
        match self {
            Self::Holes(holes) => {
                let (exit, frame) = &holes[jet];
                let from: [f64; 3] = std::array::from_fn(|a| at[a] - exit[a]);
                let (x, y) = (dot(from, frame.side), dot(from, frame.other));
                let aside = x.hypot(y);
                let towards = if aside > 0.0 { [x / aside, y / aside] } else { [0.0, 0.0] };
                (dot(from, frame.along), aside, towards)
            }
            Self::Cone { tip_m, frame, ring_m, half_angle } => {
                let from: [f64; 3] = std::array::from_fn(|a| at[a] - tip_m[a]);
                let depth = dot(from, frame.along);
                let radius = dot(from, frame.side).hypot(dot(from, frame.other)) - ring_m;
                let (sine, cosine) = half_angle.sin_cos();
                (depth * cosine + radius * sine, radius * cosine - depth * sine, [1.0, 0.0])
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_right_handed_and_the_first_side_is_x() {
        for direction in [[0.0, 0.0, -2.0], [0.3, -0.4, 1.0], [1.0, 0.0, 0.0]] {
            let frame = Frame::about(direction);
            for (a, b) in [(frame.along, frame.side), (frame.side, frame.other), (frame.other, frame.along)] {
                assert!(dot(a, b).abs() < 1e-12 && (dot(a, a) - 1.0).abs() < 1e-12);
            }
            assert!((dot(cross(frame.side, frame.other), frame.along) - 1.0).abs() < 1e-12);
        }
        assert!((Frame::about([0.0, 0.0, -1.0]).side[0] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_place_is_seen_where_it_was_put() {
        let frame = Frame::about([0.1, 0.2, -1.0]);
        let hole = Place::Holes(vec![([1e-3, 0.0, 0.0], Frame::about([0.5, 0.0, -1.0]))]);
        let cone = Place::Cone { tip_m: [0.0, 1e-3, 0.0], frame, ring_m: 2e-3, half_angle: 0.8 };
        for place in [hole, cone] {
            let (s, aside, _) = place.seen(0, place.point(0, 0.02, 0.003, 1.0));
            assert!((s - 0.02).abs() < 1e-12 && (aside - 0.003).abs() < 1e-12, "{s} {aside}");
        }
    }
}
