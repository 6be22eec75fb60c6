//! The `[chamber]` and `[[wall]]` tables: a box whose walls have temperatures and emissivities of their own.
//!
//! What no `[[wall]]` says of a wall, `[walls]` does. Sights from outside come in through the opening or window that they
//! need; those that miss the box see the laboratory (`[lab]`), or a black body as warm as `[walls]` without one.

use super::tables::{ChamberTable, SideTable};
use super::{MediumSource, Reader, Scene, SceneError, WallSource};
use crate::tracer::chamber::{Chamber, SIDE_NAMES, SIDES, Walls};
use crate::tracer::medium::{EMPTY, GridMedium};
use crate::tracer::plate::PlateShape;
use crate::tracer::shape::Shape;

/// Sights per axis that are asked whether they meet the chamber.
const SIGHTS: usize = 9;

/// A chamber with its walls.
#[derive(Debug, Clone, PartialEq)]
pub struct ChamberSource {
    /// The inside of the chamber.
    pub chamber: Chamber,
    /// The walls in the order of [`SIDE_NAMES`].
    pub walls: [WallSource; SIDES],
    /// What is seen by sights that miss the box: temperature of a black body in K.
    pub outside_k: f64,
}

impl Scene {
    /// What surrounds the medium, for these temperatures of the plate in K besides its own: walls are told apart unless they,
    /// and what they can mirror, all shine alike.
    pub fn surroundings(&self, plate_temperatures_k: &[f64]) -> Walls {
        let Some(source) = &self.chamber else { return Walls::Far };
        let kelvin = source.walls[0].temperature_k;
        let alike = |t: f64| t.total_cmp(&kelvin).is_eq();
        let gray = source.walls.iter().any(|w| w.emissivity < 1.0);
        let own = self.plate.iter().flat_map(|p| p.temperature_k);
        let lit = self.plate.as_ref().is_none_or(|p| p.temperature_k.is_some() && p.deviation.is_none());
        let windows = &self.windows;
        let glass = windows.far.iter().map(|w| w.temperature_k);
        let laboratory =
            self.plate.as_ref().is_some_and(|p| p.mirrors == Some(super::PlateMirrors::Laboratory));
        let beyond = windows.lab_temperature_k.filter(|_| windows.far.is_some() || laboratory);
        // The plate is mirrored by gray walls; so is what shines through its window or is mirrored by it.
        let mirrored =
            || own.chain(plate_temperatures_k.iter().copied()).chain(glass).chain(beyond).all(alike) && lit;
        let one = source.walls.iter().all(|w| alike(w.temperature_k))
            && (alike(source.outside_k) || self.sights_stay_inside(source))
            && (!gray || self.plate.is_none() || mirrored());
        if one { Walls::Alike(source.chamber) } else { Walls::Apart(source.chamber) }
    }

    /// Whether no sight of the camera can miss the box. Rays of one's own may come from anywhere.
    fn sights_stay_inside(&self, source: &ChamberSource) -> bool {
        self.camera.as_ref().is_some_and(|c| source.chamber.holds(c.position_m))
    }

    /// Says what is wrong where the medium does not lie inside the chamber. Shapes may reach beyond its walls and end there,
    /// gridded media may not.
    pub(super) fn medium_outside(&self) -> Option<String> {
        let chamber = &self.chamber.as_ref()?.chamber;
        let (low, high) = match &self.medium {
            Some(MediumSource::Grid(grid, _) | MediumSource::Spectral(grid, _)) => occupied(grid)?,
            Some(MediumSource::Shape(medium, _)) => {
                let apart = |low: [f64; 3], high: [f64; 3]| {
                    (0..3).any(|a| low[a] >= chamber.upper_m()[a] || high[a] <= chamber.lower_m()[a])
                };
                let away = match &medium.shape {
                    Shape::Slab { thickness_m, .. } => {
                        let half = 0.5 * thickness_m;
                        apart(
                            [f64::NEG_INFINITY, f64::NEG_INFINITY, -half],
                            [f64::INFINITY, f64::INFINITY, half],
                        )
                    }
                    Shape::Sphere { centre_m, radius_m, .. } => {
                        apart(centre_m.map(|c| c - radius_m), centre_m.map(|c| c + radius_m))
                    }
                    Shape::Cuboid { lower_m, upper_m, .. } => apart(*lower_m, *upper_m),
                    Shape::Cylinder { .. } | Shape::Gaussian { .. } => false,
                };
                return away.then(|| "[medium] lies outside the box of [chamber]".to_owned());
            }
            Some(MediumSource::Cfd(_) | MediumSource::Parametric(_)) | None => return None,
        };
        // Cells that touch a wall may stick out by the rounding of their corners.
        let room = |a: usize| 1e-9 * (chamber.upper_m()[a] - chamber.lower_m()[a]);
        let inside =
            |a: usize| low[a] >= chamber.lower_m()[a] - room(a) && high[a] <= chamber.upper_m()[a] + room(a);
        let axis = (0..3).find(|&a| !inside(a))?;
        Some(format!(
            "[chamber] the medium reaches from {:.6} m to {:.6} m along {}, beyond the walls; a gridded medium must lie \
             inside the chamber",
            low[axis],
            high[axis],
            ["x", "y", "z"][axis]
        ))
    }
}

/// Corners of the box around the occupied cells of a medium; none of an empty one.
fn occupied(grid: &GridMedium) -> Option<([f64; 3], [f64; 3])> {
    let [nx, ny, nz] = grid.cells;
    let (mut first, mut last) = (grid.cells, [0; 3]);
    for (i, _) in grid.index.iter().enumerate().filter(|&(_, &cell)| cell != EMPTY) {
        for (a, c) in [i / (ny * nz), i / nz % ny, i % nz].into_iter().enumerate() {
            first[a] = first[a].min(c);
            last[a] = last[a].max(c + 1);
        }
    }
    let corner = |cell: [usize; 3]| {
        [(0, nx), (1, ny), (2, nz)]
            .map(|(a, n)| grid.lower_m[a] + (grid.upper_m[a] - grid.lower_m[a]) * (cell[a] as f64 / n as f64))
    };
    (first[0] < last[0]).then(|| (corner(first), corner(last)))
}

impl Reader<'_> {
    pub(super) fn chamber(
        &self,
        table: Option<&ChamberTable>,
        sides: &[SideTable],
        scene: &Scene,
    ) -> Result<Option<ChamberSource>, SceneError> {
        let Some(table) = table else {
            if sides.is_empty() {
                return Ok(None);
            }
            return Err(self.wrong(
                "[wall] needs a table [chamber] with lower_m and upper_m: the box whose sides are named",
            ));
        };
        let chamber =
            Chamber::new(table.lower_m, table.upper_m).map_err(|e| self.wrong(format!("[chamber] {e}")))?;
        let walls = self.sides(sides, scene.walls)?;
        let outside_k =
            scene.windows.lab_temperature_k.or(scene.walls.map(|w| w.temperature_k)).ok_or_else(|| {
                self.wrong("[chamber] needs [walls] or [lab]: sights that miss the box see it")
            })?;
        let source = ChamberSource { chamber, walls, outside_k };
        self.plate_faces(&source, scene)?;
        self.camera_sees(&source, scene)?;
        let scene = Scene { chamber: Some(source), ..scene.clone() };
        match scene.medium_outside() {
            Some(problem) => Err(self.wrong(problem)),
            None => Ok(scene.chamber),
        }
    }

    fn sides(
        &self,
        tables: &[SideTable],
        others: Option<WallSource>,
    ) -> Result<[WallSource; SIDES], SceneError> {
        let mut named: [Option<&SideTable>; SIDES] = [None; SIDES];
        for (n, table) in tables.iter().enumerate() {
            let side = table.side as usize;
            if named[side].is_some() {
                return Err(self.wrong_in(n, format!("[wall] side \"{}\" is named twice", SIDE_NAMES[side])));
            }
            named[side] = Some(table);
            if table.temperature_k.is_none() && table.emissivity.is_none() {
                return Err(self
                    .wrong_in(n, "[wall] side alone says nothing: give temperature_k, emissivity, or both"));
            }
            if table.temperature_k.is_some_and(|t| !(t >= 0.0 && t.is_finite())) {
                return Err(self.wrong_in(n, "[wall] temperature_k must be finite and not negative"));
            }
            if table.emissivity.is_some_and(|e| !(e > 0.0 && e <= 1.0)) {
                return Err(self.wrong_in(n, "[wall] emissivity must be above 0 and at most 1"));
            }
        }
        let mut walls = [WallSource { temperature_k: 0.0, emissivity: 1.0 }; SIDES];
        for (side, wall) in walls.iter_mut().enumerate() {
            let table = named[side];
            let Some(temperature_k) = table.and_then(|t| t.temperature_k).or(others.map(|w| w.temperature_k))
            else {
                return Err(self.wrong(format!(
                    "[chamber] nothing says how warm the wall {} is: give [walls] with its temperature_k, for all walls \
                     that no [[wall]] names, or a [[wall]] for each",
                    SIDE_NAMES[side]
                )));
            };
            let emissivity = table.and_then(|t| t.emissivity).or(others.map(|w| w.emissivity)).unwrap_or(1.0);
            *wall = WallSource { temperature_k, emissivity };
        }
        Ok(walls)
    }

    /// A plate must have some of the chamber in front of it.
    fn plate_faces(&self, source: &ChamberSource, scene: &Scene) -> Result<(), SceneError> {
        let Some(PlateShape::Rectangle { centre_m, facing, .. } | PlateShape::Disc { centre_m, facing, .. }) =
            scene.plate.as_ref().map(|p| &p.shape)
        else {
            return Ok(());
        };
        let corners = [source.chamber.lower_m(), source.chamber.upper_m()];
        let faced = (0..8).any(|k: usize| {
            (0..3).map(|a| facing[a] * (corners[k >> a & 1][a] - centre_m[a])).sum::<f64>() > 0.0
        });
        if faced { Ok(()) } else { Err(self.wrong("[plate] facing is away from the box of [chamber]")) }
    }

    /// Some sight must meet the chamber.
    fn camera_sees(&self, source: &ChamberSource, scene: &Scene) -> Result<(), SceneError> {
        let Some(camera) = scene.camera.as_ref().filter(|c| c.rows > 0 && c.columns > 0) else {
            return Ok(());
        };
        let sights = camera.sights().map_err(|e| self.wrong(format!("[camera] {e}")))?;
        let part = |k: usize, n: usize| k as f64 / (SIGHTS - 1) as f64 * n as f64;
        let met = (0..SIGHTS * SIGHTS).any(|k| {
            let (row, column) = (part(k / SIGHTS, camera.rows), part(k % SIGHTS, camera.columns));
            let (origin, direction) = sights.ray(row, column);
            source.chamber.end(origin, direction) < SIDES
        });
        if met {
            Ok(())
        } else {
            Err(self.wrong("[camera] look_at_m: the camera sees nothing of the box of [chamber]"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Scene, SceneError, load};
    use super::*;

    fn scene(text: &str) -> Result<Scene, SceneError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        load(&path)
    }

    const CHAMBER: &str = "[chamber]\nlower_m = [-1, -1, -1]\nupper_m = [1, 1, 1]\n";
    const WALLS: &str = "[walls]\ntemperature_k = 300\nemissivity = 0.8\n";

    fn refused(text: &str, words: &[&str]) {
        let error = scene(text).unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }

    #[test]
    fn walls_that_are_not_named_are_those_of_the_table_for_all() {
        let text = format!(
            "{WALLS}{CHAMBER}[[wall]]\nside = \"y+\"\ntemperature_k = 420\n[[wall]]\nside = \"z-\"\nemissivity = 0.1\n"
        );
        let scene = scene(&text).unwrap();
        let chamber = scene.chamber.as_ref().unwrap();
        let wall = |temperature_k, emissivity| WallSource { temperature_k, emissivity };
        let other = wall(300.0, 0.8);
        assert_eq!(chamber.walls, [other, other, other, wall(420.0, 0.8), wall(300.0, 0.1), other]);
        assert!((chamber.outside_k - 300.0).abs() < 1e-12);
        assert!(matches!(scene.surroundings(&[]), Walls::Apart(_)));
    }

    #[test]
    fn a_chamber_that_shines_as_one_is_not_divided() {
        let plate = "[plate]\nshape = \"disc\"\ncentre_m = [0, 1, 0]\nfacing = [0, -1, 0]\ndiameter_m = 1\n";
        let alike =
            |text: &str, more: &[f64]| matches!(scene(text).unwrap().surroundings(more), Walls::Alike(_));
        assert!(alike(&format!("{WALLS}{CHAMBER}"), &[]));
        assert!(alike(&format!("{WALLS}{CHAMBER}{plate}temperature_k = 300\n"), &[300.0]));
        assert!(!alike(&format!("{WALLS}{CHAMBER}{plate}temperature_k = 300\n"), &[301.0]));
        // A plate without a temperature may have any.
        assert!(!alike(&format!("{WALLS}{CHAMBER}{plate}"), &[]));
        // Black walls mirror nothing.
        let black = WALLS.replace("0.8", "1");
        assert!(alike(&format!("{black}{CHAMBER}{plate}temperature_k = 400\n"), &[]));
        // Rays may miss the box, where another laboratory is.
        assert!(!alike(&format!("{black}{CHAMBER}[lab]\ntemperature_k = 290\n"), &[]));
        assert!(matches!(scene(WALLS).unwrap().surroundings(&[]), Walls::Far));
    }

    #[test]
    fn chambers_that_make_no_sense_are_refused_in_words() {
        let side = |name: &str| format!("[[wall]]\nside = \"{name}\"\ntemperature_k = 400\n");
        refused(&format!("{WALLS}{CHAMBER}{}", side("top")), &["line 8", "top", "x-", "z+"]);
        refused(&format!("{WALLS}{CHAMBER}{0}{0}", side("x+")), &["x+", "twice", "line 11"]);
        refused(&format!("{WALLS}{}", side("x+")), &["[chamber]", "lower_m", "line 4"]);
        refused(&format!("{CHAMBER}{}", side("x-")), &["wall x+", "[walls]"]);
        refused(&format!("{WALLS}{CHAMBER}[[wall]]\nside = \"x+\"\n"), &["alone", "line 8"]);
        refused(
            &format!("{WALLS}{CHAMBER}[[wall]]\nside = \"x+\"\nemissivity = 0\n"),
            &["line 9", "emissivity"],
        );
        refused(
            &format!("{WALLS}{CHAMBER}[[wall]]\nside = \"x+\"\ntemperature_k = -1\n"),
            &["line 9", "negative"],
        );
        refused(&format!("{WALLS}{}", CHAMBER.replace("[1, 1, 1]", "[1, 1, -1]")), &["[chamber]", "upper_m"]);
        let all: String = SIDE_NAMES.iter().map(|s| side(s)).collect();
        refused(&format!("{CHAMBER}{all}"), &["[lab]", "miss"]);
        assert!(scene(&format!("{CHAMBER}{all}[lab]\ntemperature_k = 290\n")).unwrap().walls.is_some());
    }

    #[test]
    fn what_stands_outside_the_chamber_is_refused() {
        let base = format!("{WALLS}{CHAMBER}");
        let camera = |at: &str, to: &str| {
            format!(
                "[camera]\nkind = \"pinhole\"\nposition_m = {at}\nlook_at_m = {to}\nup = [0, 0, 1]\ncolumns = 4\nrows = 3\n\
                 horizontal_fov_deg = 10\n"
            )
        };
        assert!(scene(&format!("{base}{}", camera("[0, -5, 0]", "[0, 0, 0]"))).is_ok());
        refused(&format!("{base}{}", camera("[0, -5, 0]", "[0, -6, 0]")), &["[camera]", "nothing"]);
        let plate = "[plate]\nshape = \"disc\"\ncentre_m = [0, 2, 0]\nfacing = [0, 1, 0]\ndiameter_m = 1\n";
        refused(&format!("{base}{plate}"), &["[plate]", "away"]);
        let sphere = |x: f64| {
            format!(
                "[medium]\nkind = \"sphere\"\ncentre_m = [{x}, 0, 0]\nradius_m = 1\nextinction = 1\nalbedo = 0\n"
            )
        };
        assert!(scene(&format!("{base}{}", sphere(1.5))).is_ok());
        refused(&format!("{base}{}", sphere(2.5)), &["[medium]", "outside"]);
        assert!(
            scene(&format!(
                "{base}[medium]\nkind = \"slab\"\noptical_depth = 1\nthickness_m = 4\nalbedo = 0\n"
            ))
            .is_ok()
        );
    }
}
