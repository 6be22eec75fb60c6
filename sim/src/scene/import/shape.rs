//! Cells as boxes: bounding box, volume, centre of a polyhedron, and the few vector rules they need.

/// Relative difference of volumes up to which a cell is its bounding box: rounding only, because the corners of
/// an axis-parallel cell share their coordinates in every form, single precision included.
const ROUNDING: f64 = 1e-9;

/// Relative difference of volumes up to which a cell is called a box.
const BOX_TOLERANCE: f64 = 1e-4;

/// An axis-parallel box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Box3 {
    pub(super) lower: [f64; 3],
    pub(super) upper: [f64; 3],
}

impl Box3 {
    pub(super) const EMPTY: Self = Self { lower: [f64::INFINITY; 3], upper: [f64::NEG_INFINITY; 3] };

    pub(super) fn extend(&mut self, point: [f64; 3]) {
        for (a, x) in point.into_iter().enumerate() {
            self.lower[a] = self.lower[a].min(x);
            self.upper[a] = self.upper[a].max(x);
        }
    }

    pub(super) fn volume(&self) -> f64 {
        (0..3).map(|a| self.upper[a] - self.lower[a]).product()
    }

    /// The box that stands for a cell of this bounding box, volume and centre; true if the cell is no box.
    pub(super) fn stand_in(self, volume: f64, centre: [f64; 3]) -> (Self, bool) {
        let full = self.volume();
        if (volume - full).abs() <= ROUNDING * full {
            return (self, false);
        }
        let shrink = (volume / full).cbrt();
        let half: [f64; 3] = std::array::from_fn(|a| 0.5 * shrink * (self.upper[a] - self.lower[a]));
        let stood = Self {
            lower: std::array::from_fn(|a| centre[a] - half[a]),
            upper: std::array::from_fn(|a| centre[a] + half[a]),
        };
        (stood, (volume - full).abs() > BOX_TOLERANCE * full)
    }
}

/// Bounding box, volume and centre of a polyhedron given by its faces; faces may be oriented either way.
///
/// Each face is cut into triangles about its mean point; the tetrahedra to the mean of the face means are taken
/// as positive, which is exact for cells that this point sees whole.
pub(super) fn polyhedron<'a>(
    point: impl Fn(usize) -> [f64; 3],
    faces: impl Iterator<Item = &'a [usize]> + Clone,
) -> (Box3, f64, [f64; 3]) {
    let mut bounds = Box3::EMPTY;
    let mut middle = [0.0; 3];
    let mut count = 0.0;
    for face in faces.clone() {
        let mut mean = [0.0; 3];
        for &p in face {
            bounds.extend(point(p));
            mean = add(mean, point(p));
        }
        middle = add(middle, scale(mean, 1.0 / face.len() as f64));
        count += 1.0;
    }
    middle = scale(middle, 1.0 / count);
    let mut volume = 0.0;
    let mut moment = [0.0; 3];
    for face in faces {
        let mean = scale(face.iter().fold([0.0; 3], |sum, &p| add(sum, point(p))), 1.0 / face.len() as f64);
        for i in 0..face.len() {
            let (a, b) = (point(face[i]), point(face[(i + 1) % face.len()]));
            let tet = (dot(cross(sub(a, middle), sub(b, middle)), sub(mean, middle)) / 6.0).abs();
            volume += tet;
            moment = add(moment, scale(add(add(a, b), add(mean, middle)), 0.25 * tet));
        }
    }
    let centre = if volume > 0.0 { scale(moment, 1.0 / volume) } else { middle };
    (bounds, volume, centre)
}

/// Corner numbers of the faces of the standard cells, by their number of corners (VTK and EnSight agree).
pub(super) fn standard_faces(corners: usize) -> Option<&'static [&'static [usize]]> {
    match corners {
        4 => Some(&[&[0, 1, 2], &[0, 1, 3], &[1, 2, 3], &[0, 2, 3]]),
        5 => Some(&[&[0, 1, 2, 3], &[0, 1, 4], &[1, 2, 4], &[2, 3, 4], &[3, 0, 4]]),
        6 => Some(&[&[0, 1, 2], &[3, 4, 5], &[0, 1, 4, 3], &[1, 2, 5, 4], &[2, 0, 3, 5]]),
        8 => {
            Some(&[&[0, 1, 2, 3], &[4, 5, 6, 7], &[0, 1, 5, 4], &[1, 2, 6, 5], &[2, 3, 7, 6], &[3, 0, 4, 7]])
        }
        _ => None,
    }
}

pub(super) fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(super) fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(super) fn scale(a: [f64; 3], s: f64) -> [f64; 3] {
    [a[0] * s, a[1] * s, a[2] * s]
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standard_cells_have_the_volumes_of_geometry() {
        let cube = [
            [0., 0., 0.],
            [1., 0., 0.],
            [1., 1., 0.],
            [0., 1., 0.],
            [0., 0., 1.],
            [1., 0., 1.],
            [1., 1., 1.],
            [0., 1., 1.],
        ];
        // Corners of the cube in each cell's order, and the volume.
        let cases: [(&[usize], f64); 4] = [
            (&[0, 1, 3, 4], 1.0 / 6.0),
            (&[0, 1, 2, 3, 4], 1.0 / 3.0),
            (&[0, 1, 3, 4, 5, 7], 0.5),
            (&[0, 1, 2, 3, 4, 5, 6, 7], 1.0),
        ];
        for (corners, expected) in cases {
            let faces = standard_faces(corners.len()).unwrap();
            let (_, volume, _) = polyhedron(|i| cube[corners[i]], faces.iter().copied());
            assert!((volume - expected).abs() < 1e-15, "{} corners: {volume}", corners.len());
        }
    }

    #[test]
    fn a_tetrahedron_is_stood_for_by_a_box_of_its_volume() {
        let points = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        let (bounds, volume, centre) = polyhedron(|i| points[i], standard_faces(4).unwrap().iter().copied());
        assert!(centre.iter().all(|c| (c - 0.25).abs() < 1e-15));
        let (stood, shaped) = bounds.stand_in(volume, centre);
        assert!(shaped && (stood.volume() - 1.0 / 6.0).abs() < 1e-15);
    }
}
