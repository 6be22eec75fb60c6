//! The `phase = { … }` of a medium: which function, and whether its forward peak is cut off.

use super::tables::PhaseChoice;
use super::{Reader, SceneError};
use crate::light::phase::truncation::{self, Truncation};
use crate::light::phase::{PhaseFunction, PhaseTable};
use crate::tracer::medium::GridMedium;
use crate::tracer::shape::{Shape, ShapeMedium};
use std::sync::Arc;

/// How a medium scatters: a function, and a cone that counts as unscattered.
#[derive(Debug, Clone)]
pub(super) struct Scattering {
    pub(super) phase: PhaseFunction,
    pub(super) truncation: Option<Truncation>,
}

impl Reader<'_> {
    pub(super) fn scattering(
        &self,
        choice: &PhaseChoice,
        notes: &mut Vec<String>,
    ) -> Result<Scattering, SceneError> {
        let (phase, truncate_deg) = match choice {
            PhaseChoice::Isotropic {} => (PhaseFunction::Isotropic, None),
            PhaseChoice::HenyeyGreenstein { asymmetry, truncate_deg } if asymmetry.abs() <= 1.0 => {
                (PhaseFunction::HenyeyGreenstein { asymmetry: *asymmetry }, *truncate_deg)
            }
            PhaseChoice::HenyeyGreenstein { asymmetry, .. } => {
                return Err(self.wrong(format!("phase: asymmetry {asymmetry} is outside -1 to 1")));
            }
            PhaseChoice::Table { file, truncate_deg } => {
                let path = self.folder.join(file);
                let points = self.columns(&path, ["theta_deg", "p11"])?;
                let theta: Vec<f64> = points.iter().map(|p| p.0.to_radians()).collect();
                let p11: Vec<f64> = points.iter().map(|p| p.1).collect();
                let (table, norm) = PhaseTable::new(&theta, &p11)
                    .map_err(|e| SceneError::Array { path: path.clone(), problem: e.to_string() })?;
                notes.push(format!("{}: norm {norm:.9} found, renormalised to 1", file.display()));
                (PhaseFunction::Table(Arc::new(table)), *truncate_deg)
            }
        };
        let Some(degrees) = truncate_deg else { return Ok(Scattering { phase, truncation: None }) };
        let cut = cut(&phase, degrees).map_err(|problem| self.wrong(format!("[medium] {problem}")))?;
        notes.push(told(&[&cut], degrees));
        Ok(Scattering { phase: cut.phase.clone(), truncation: Some(cut) })
    }
}

/// Cuts off a cone of a half angle in degrees.
pub(super) fn cut(phase: &PhaseFunction, degrees: f64) -> Result<Truncation, String> {
    truncation::cone(phase, degrees.to_radians())
        .map_err(|_| format!("phase: truncate_deg is {degrees}, it must be above 0 and at most 90"))
}

/// What cutting off the peak does, for the notes: the largest over the groups.
pub(super) fn told(cuts: &[&Truncation], degrees: f64) -> String {
    let largest = |of: &dyn Fn(&Truncation) -> f64| cuts.iter().map(|cut| of(cut)).fold(0.0, f64::max);
    format!(
        "phase: up to {:.4} of the scattered light, within {degrees} deg, counts as unscattered; estimated rms error of a \
         coefficient {:.1e} per scattering",
        largest(&|cut| cut.fraction),
        largest(&|cut| cut.error(1.0, std::f64::consts::PI)),
    )
}

impl Scattering {
    /// A shape whose extinction and albedo are those of the whole scattering.
    pub(super) fn shape(self, mut shape: Shape, albedo: f64) -> ShapeMedium {
        let Some(cut) = self.truncation.filter(|_| (0.0..=1.0).contains(&albedo)) else {
            return ShapeMedium { shape, albedo, phase: self.phase };
        };
        match &mut shape {
            Shape::Slab { optical_depth: k, .. }
            | Shape::Sphere { extinction: k, .. }
            | Shape::Cylinder { extinction: k, .. }
            | Shape::Gaussian { extinction: k, .. }
            | Shape::Cuboid { extinction: k, .. } => {
                // An infinite depth stays one, also if all of it were to count as unscattered.
                if k.is_finite() {
                    *k = cut.extinction(*k, albedo);
                }
            }
        }
        ShapeMedium { shape, albedo: cut.albedo(albedo), phase: self.phase }
    }
}

/// Takes the unscattered share out of the coefficients of a grid, for one cut per group.
pub(super) fn thin(medium: &mut GridMedium, cuts: &[Truncation]) {
    let groups = medium.groups;
    for (entry, (ext, sca)) in medium.k_ext.iter_mut().zip(&mut medium.k_sca).enumerate() {
        let cut = &cuts[entry % groups];
        *ext = (*ext - cut.fraction * *sca).max(0.0);
        *sca = cut.scattering(*sca).min(*ext);
    }
    for (phase, cut) in medium.phase.iter_mut().zip(cuts) {
        *phase = cut.phase.clone();
    }
}
