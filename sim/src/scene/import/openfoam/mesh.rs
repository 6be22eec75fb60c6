//! A polyhedral OpenFOAM mesh: cell boxes and volumes, and the tetrahedra that place parcels.
//!
//! Centres follow OpenFOAM's own rules (`primitiveMeshFaceCentresAndAreas.C`, `primitiveMeshCellCentresAndVols.C`,
//! `polyMeshTetDecomposition.C` of v1912), because barycentric coordinates refer to them.

use super::super::error::{Place, SceneError};
use super::super::shape::{Box3, add, cross, dot, scale, sub};
use super::foam_file::{Faces, FoamFile, Folder};

/// Quality below which OpenFOAM does not take a tetrahedron for positive (`minTetQuality` = sqr(1e-15)).
const TET_QUALITY_MIN: f64 = 1e-30;

/// A mesh.
#[derive(Debug)]
pub(super) struct Mesh {
    points: Vec<[f64; 3]>,
    faces: Faces,
    owner: Vec<u32>,
    neighbour: Vec<u32>,
    /// Patches to other processors.
    pub(super) seams: Vec<Seam>,
    centres: Vec<[f64; 3]>,
    volumes: Vec<f64>,
    boxes: Vec<Box3>,
}

/// The faces that a processor's mesh shares with another's, in the same order on both sides.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Seam {
    pub(super) here: usize,
    pub(super) there: usize,
    pub(super) first_face: usize,
    pub(super) faces: usize,
}

impl Mesh {
    /// Reads `faces`, `owner`, `neighbour` and `boundary` of a `polyMesh` folder, and `points` of a perhaps newer one.
    pub(super) fn read(folder: &Folder, points_folder: &Folder) -> Result<Self, SceneError> {
        let ((points, faces), (owner, neighbour)) = rayon::join(
            || {
                rayon::join(
                    || FoamFile::need(points_folder, "points").and_then(|f| f.vectors()),
                    || FoamFile::need(folder, "faces").and_then(|f| f.faces()),
                )
            },
            || {
                rayon::join(
                    || FoamFile::need(folder, "owner").and_then(|f| f.labels()),
                    || FoamFile::need(folder, "neighbour").and_then(|f| f.labels()),
                )
            },
        );
        let seams = FoamFile::find(folder, "boundary")?.map(|f| seams(&f.text())).unwrap_or_default();
        let mut mesh = Self {
            points: points?,
            faces: faces?,
            owner: owner?,
            neighbour: neighbour?,
            seams,
            centres: Vec::new(),
            volumes: Vec::new(),
            boxes: Vec::new(),
        };
        mesh.check(folder)?;
        mesh.measure();
        Ok(mesh)
    }

    /// Number of cells.
    pub(super) fn cells(&self) -> usize {
        self.boxes.len()
    }

    /// Bounding box of a cell's points.
    pub(super) fn cell_box(&self, cell: usize) -> Box3 {
        self.boxes[cell]
    }

    /// Volume of a cell in m³.
    pub(super) fn volume_m3(&self, cell: usize) -> f64 {
        self.volumes[cell]
    }

    /// OpenFOAM's centre of a cell in metres.
    pub(super) fn centre_m(&self, cell: usize) -> [f64; 3] {
        self.centres[cell]
    }

    /// Cell centres along a seam, in the seam's order.
    pub(super) fn seam_centres(&self, seam: &Seam) -> Vec<[f64; 3]> {
        (0..seam.faces).map(|i| self.centres[self.owner[seam.first_face + i] as usize]).collect()
    }

    /// Position in metres of a parcel given by barycentric coordinates; `None` if its numbers do not fit the mesh.
    ///
    /// `beyond` gives the centre of the cell on the other side of a seam's face, if the face lies on a seam.
    pub(super) fn position_m(
        &self,
        weights: [f64; 4],
        place: [usize; 3],
        beyond: &dyn Fn(usize) -> Option<([f64; 3], bool)>,
    ) -> Option<[f64; 3]> {
        let [cell, face, tet_point] = place;
        if cell >= self.cells() || face >= self.faces.len() {
            return None;
        }
        let corners = self.faces.points(face);
        if tet_point == 0 || tet_point >= corners.len() {
            return None;
        }
        let base = self.base(face, beyond(face));
        let mut p = (tet_point + base) % corners.len();
        let mut q = (p + 1) % corners.len();
        if self.owner[face] as usize != cell {
            std::mem::swap(&mut p, &mut q);
        }
        let corner = |i: usize| self.points[corners[i] as usize];
        let mut position = scale(self.centres[cell], weights[0]);
        for (weight, point) in [(weights[1], corner(base)), (weights[2], corner(p)), (weights[3], corner(q))]
        {
            position = add(position, scale(point, weight));
        }
        Some(position)
    }

    /// The first point of a face from which all tetrahedra to both cells' centres are positive; 0 if there is none.
    ///
    /// On a seam the side with the lower number decides, and the other sees the face reversed.
    fn base(&self, face: usize, beyond: Option<([f64; 3], bool)>) -> usize {
        let corners = self.faces.points(face);
        let inside = self.centres[self.owner[face] as usize];
        let across = self.neighbour.get(face).map(|&n| self.centres[n as usize]);
        match (across, beyond) {
            (Some(other), _) => {
                first_base(corners.len(), |i| self.points[corners[i] as usize], inside, Some(other))
            }
            (None, Some((other, true))) => {
                first_base(corners.len(), |i| self.points[corners[i] as usize], inside, Some(other))
            }
            (None, Some((other, false))) => {
                let count = corners.len();
                let reversed = |i: usize| self.points[corners[(count - i) % count] as usize];
                let base = first_base(count, reversed, other, Some(inside));
                (count - base) % count
            }
            (None, None) => first_base(corners.len(), |i| self.points[corners[i] as usize], inside, None),
        }
    }

    fn check(&self, folder: &Folder) -> Result<(), SceneError> {
        let refuse = |name: &str, expected: String, found: String| {
            Err(SceneError::malformed(&folder.path.join(name), Place::Whole, expected, found))
        };
        let faces = self.faces.len();
        if self.owner.len() != faces {
            return Err(SceneError::length(
                &folder.path.join("owner"),
                "owners of the faces",
                faces,
                self.owner.len(),
            ));
        }
        if self.neighbour.len() > faces {
            let count = self.neighbour.len();
            return refuse("neighbour", format!("at most {faces} neighbours"), count.to_string());
        }
        if let Some(&point) = self.faces.point.iter().find(|&&p| p as usize >= self.points.len()) {
            return refuse("faces", format!("points below {}", self.points.len()), point.to_string());
        }
        if let Some(face) = (0..faces).find(|&f| self.faces.points(f).len() < 3) {
            return refuse("faces", "at least three points a face".into(), format!("fewer in face {face}"));
        }
        let cells = self.owner.iter().max().map_or(0, |&m| m as usize + 1);
        if cells > faces {
            return refuse("owner", format!("cells below {faces}"), (cells - 1).to_string());
        }
        if let Some(&cell) = self.neighbour.iter().find(|&&n| n as usize >= cells) {
            return refuse("neighbour", format!("cells below {cells}"), cell.to_string());
        }
        let mut has_face = vec![false; cells];
        (0..faces).for_each(|face| self.sides_of(face).for_each(|cell| has_face[cell] = true));
        if let Some(cell) = has_face.iter().position(|has| !has) {
            return refuse(
                "owner",
                format!("faces of each of {cells} cells"),
                format!("none of cell {cell}"),
            );
        }
        if self.seams.iter().any(|s| s.first_face + s.faces > faces) {
            return refuse("boundary", format!("patches within {faces} faces"), "a patch beyond them".into());
        }
        Ok(())
    }

    fn measure(&mut self) {
        let cells = self.owner.iter().max().map_or(0, |&m| m as usize + 1);
        let sides: Vec<([f64; 3], [f64; 3])> =
            (0..self.faces.len()).map(|f| self.face_centre_area(f)).collect();
        let mut guess = vec![[0.0; 3]; cells];
        let mut count = vec![0_u32; cells];
        self.boxes = vec![Box3::EMPTY; cells];
        for (face, &(centre, _)) in sides.iter().enumerate() {
            for cell in self.sides_of(face) {
                guess[cell] = add(guess[cell], centre);
                count[cell] += 1;
                for &point in self.faces.points(face) {
                    self.boxes[cell].extend(self.points[point as usize]);
                }
            }
        }
        for (sum, &count) in guess.iter_mut().zip(&count) {
            *sum = scale(*sum, 1.0 / f64::from(count));
        }
        let mut moment = vec![[0.0; 3]; cells];
        let mut volume = vec![0.0; cells];
        for (face, &(centre, area)) in sides.iter().enumerate() {
            for (side, cell) in self.sides_of(face).enumerate() {
                let sign = if side == 0 { 1.0 } else { -1.0 };
                let pyramid = sign * dot(area, sub(centre, guess[cell]));
                let middle = add(scale(centre, 0.75), scale(guess[cell], 0.25));
                moment[cell] = add(moment[cell], scale(middle, pyramid));
                volume[cell] += pyramid;
            }
        }
        self.centres = (0..cells)
            .map(|c| if volume[c].abs() > 1e-300 { scale(moment[c], 1.0 / volume[c]) } else { guess[c] })
            .collect();
        self.volumes = volume.into_iter().map(|v| v / 3.0).collect();
    }

    fn sides_of(&self, face: usize) -> impl Iterator<Item = usize> + use<> {
        let neighbour = self.neighbour.get(face).map(|&n| n as usize);
        std::iter::once(self.owner[face] as usize).chain(neighbour)
    }

    fn face_centre_area(&self, face: usize) -> ([f64; 3], [f64; 3]) {
        let corners = self.faces.points(face);
        let corner = |i: usize| self.points[corners[i % corners.len()] as usize];
        if corners.len() == 3 {
            let (a, b, c) = (corner(0), corner(1), corner(2));
            return (scale(add(add(a, b), c), 1.0 / 3.0), scale(cross(sub(b, a), sub(c, a)), 0.5));
        }
        let mut mean = corner(0);
        for i in 1..corners.len() {
            mean = add(mean, corner(i));
        }
        mean = scale(mean, 1.0 / corners.len() as f64);
        let mut normals = [0.0; 3];
        let mut areas = 0.0;
        let mut moment = [0.0; 3];
        for i in 0..corners.len() {
            let (here, next) = (corner(i), corner(i + 1));
            let normal = cross(sub(next, here), sub(mean, here));
            let area = dot(normal, normal).sqrt();
            normals = add(normals, normal);
            areas += area;
            moment = add(moment, scale(add(add(here, next), mean), area));
        }
        if areas < 1e-300 {
            return (mean, [0.0; 3]);
        }
        (scale(moment, 1.0 / (3.0 * areas)), scale(normals, 0.5))
    }
}

fn first_base(
    count: usize,
    corner: impl Fn(usize) -> [f64; 3],
    inside: [f64; 3],
    across: Option<[f64; 3]>,
) -> usize {
    let all_positive = |base: usize| {
        (1..count - 1).all(|i| {
            let (here, next) = (corner((base + i) % count), corner((base + i + 1) % count));
            tet_quality(inside, corner(base), here, next) > TET_QUALITY_MIN
                && across.is_none_or(|centre| tet_quality(centre, corner(base), next, here) > TET_QUALITY_MIN)
        })
    };
    (0..count).find(|&base| all_positive(base)).unwrap_or(0)
}

/// Volume over that of the regular tetrahedron in the same sphere (`tetrahedron::quality`).
fn tet_quality(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> f64 {
    let (ab, ac, ad) = (sub(b, a), sub(c, a), sub(d, a));
    let volume = dot(cross(ab, ac), ad) / 6.0;
    // Twice the way from `a` to the centre of the sphere is ab + along.
    let (across, aside) = (cross(ac, ab), cross(ad, ab));
    let lambda = dot(ad, ad) - dot(ab, ad);
    let mu = dot(ac, ac) - dot(ab, ac);
    let denominator = dot(ad, across);
    let radius = if denominator.abs() < 1e-150 {
        1e15
    } else {
        let along = scale(sub(scale(across, lambda), scale(aside, mu)), 1.0 / denominator);
        0.5 * dot(add(ab, along), add(ab, along)).sqrt()
    };
    volume / (8.0 / (9.0 * 3.0_f64.sqrt()) * radius.min(1e15).powi(3) + 1e-150)
}

/// The processor patches of a `boundary` file's text.
fn seams(text: &str) -> Vec<Seam> {
    let mut found = Vec::new();
    for block in text.split('{').skip(1) {
        let block = block.split('}').next().unwrap_or_default();
        let value = |key: &str| {
            block.split(';').find_map(|entry| {
                let (name, value) = entry.trim().split_once(char::is_whitespace)?;
                (name == key).then(|| value.trim())
            })
        };
        let number = |key: &str| value(key).and_then(|v| v.parse::<usize>().ok());
        if value("type").is_some_and(|t| t.starts_with("processor"))
            && let (Some(here), Some(there), Some(first_face), Some(faces)) =
                (number("myProcNo"), number("neighbProcNo"), number("startFace"), number("nFaces"))
        {
            found.push(Seam { here, there, first_face, faces });
        }
    }
    found
}
