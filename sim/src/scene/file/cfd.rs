//! A spray as a medium: the place where import and deposit, or the parametric models, and optics are joined.

use super::phase::{cut, thin, told};
use super::{BandSource, CfdSource, MediumSource, Samples, Scene, SceneError};
use crate::light::band::{Absorbers, Band};
use crate::light::fuel::Fuel;
use crate::light::phase::truncation::Truncation;
use crate::scene::deposit::{self, DepositOptions, DepositReport, Move, Placement, Sectors};
use crate::scene::field::SprayField;
use crate::scene::import::{self, ImportOptions, Time};
use crate::scene::optics::{Optics, OpticsOptions, OpticsReport, Source};
use crate::scene::{compact, library, optics};
use crate::tracer::image::GROUPS_MAX;
use std::path::Path;

/// Largest error of band emissivities that automatic sampling admits.
const EMISSIVITY_ERROR: f64 = 1e-3;

/// Relative difference of times that are the same.
const SAME_TIME: f64 = 1e-6;

impl Scene {
    /// Makes the scene's spray, if it has one, for a purpose: imports it from CFD or follows it from its injector. Says
    /// in its notes how. Other scenes stay as they are.
    ///
    /// # Errors
    ///
    /// [`SceneError`] for a spray that cannot be read or made, an unknown fuel, or a scene without band.
    pub fn with_spray(mut self, options: &OpticsOptions) -> Result<Self, SceneError> {
        let path = match &self.medium {
            Some(MediumSource::Cfd(source)) => source.scene.clone(),
            Some(MediumSource::Parametric(source)) => source.scene.clone(),
            _ => return Ok(self),
        };
        let made = match &self.medium {
            Some(MediumSource::Cfd(source)) => {
                let (fuel, field, deposit, notes) = imported(source)?;
                self.deposit = Some(deposit);
                Made {
                    scene: &source.scene,
                    kind: "cfd",
                    fuel,
                    field,
                    notes,
                    truncate_deg: source.truncate_deg,
                }
            }
            Some(MediumSource::Parametric(source)) => {
                let (fuel, spray) = source.made()?;
                self.shots = Some(spray.shots);
                Made {
                    scene: &source.scene,
                    kind: source.spray.injector.kind(),
                    fuel,
                    field: spray.field,
                    notes: spray.summary.notes(),
                    truncate_deg: source.spray.truncate_deg,
                }
            }
            _ => return Ok(self),
        };
        let (medium, report, notes) = spectral(made, self.band.as_ref(), options)?;
        self.medium = Some(medium);
        self.optics = Some(report);
        self.notes.extend(notes);
        match self.medium_outside() {
            Some(problem) => Err(SceneError::Meaning { path, line: None, problem }),
            None => Ok(self),
        }
    }
}

/// A spray on a grid, and what its coefficients depend on besides.
struct Made<'a> {
    scene: &'a Path,
    kind: &'a str,
    fuel: Fuel,
    field: SprayField,
    notes: Vec<String>,
    truncate_deg: Option<f64>,
}

/// A message about a scene file, with the line it is about.
fn meaning(scene: &Path, problem: String) -> SceneError {
    let text = std::fs::read_to_string(scene).unwrap_or_default();
    SceneError::Meaning { path: scene.to_owned(), line: super::line_of(&text, 0, &problem), problem }
}

/// A CFD spray, read and spread on its grid.
fn imported(source: &CfdSource) -> Result<(Fuel, SprayField, DepositReport, Vec<String>), SceneError> {
    let mut notes = Vec::new();
    let wrong = |problem: String| meaning(&source.scene, problem);
    let unread = |e| SceneError::Spray { path: source.scene.clone(), source: Box::new(e) };
    let folder = source.scene.parent().unwrap_or(Path::new(""));
    let fuel = library::fuel(&source.fuel, folder).map_err(|e| wrong(format!("[medium] fuel: {e}")))?;
    let spray = if source.embedded {
        let spray = compact::shipped().map_err(unread)?;
        if let Some(t) = source.time_s.filter(|t| (t - spray.time_s).abs() > SAME_TIME * spray.time_s) {
            return Err(wrong(format!(
                "[medium] time_s is {t}; {} has {} only",
                compact::SHIPPED,
                spray.time_s
            )));
        }
        spray
    } else {
        let time = source.time_s.map_or(Time::Latest, Time::At);
        if !(source.length_unit_m.is_finite() && source.length_unit_m > 0.0) {
            return Err(wrong(format!(
                "[medium] length_unit_m is {}; it must be positive",
                source.length_unit_m
            )));
        }
        let wanted = ImportOptions {
            fuel: source.fuel_field.clone(),
            // The scene names the fuel anyway; its molar mass serves fields under names that tell none.
            fuel_molar_mass_kg_mol: import::fuel_molar_mass(source.fuel_field.as_deref().unwrap_or_default())
                .or_else(|| source.fuel_field.as_ref().and_then(|_| import::fuel_molar_mass(&source.fuel))),
            length_unit_m: source.length_unit_m,
            ..ImportOptions::default()
        };
        import::read(&source.path, time, &wanted).map_err(unread)?
    };
    notes.extend(spray.notes.iter().map(|note| format!("spray: {note}")));
    let placement = placement(source).map_err(unread)?;
    let sectors = match (source.sectors, source.axis) {
        (1, _) => None,
        (number, Some(axis)) => Some(Sectors { number, tip_m: source.tip_m.unwrap_or([0.0; 3]), axis }),
        (_, None) => {
            return Err(wrong("[medium] sectors needs axis: the spray is turned about it".to_owned()));
        }
    };
    let spread = DepositOptions { cell_m: source.cell_m, sectors, placement, ..DepositOptions::default() };
    let (field, deposit) = deposit::field(&spray, &spread).map_err(unread)?;
    notes.push(format!(
        "spray at {:.3e} s: {} cells of {:.3e} m, {} with droplets, {} with vapour; {} parcels outside, {} junk",
        spray.time_s,
        deposit.cells,
        deposit.cell_m[0],
        deposit.droplet_cells,
        deposit.vapour_cells,
        deposit.outside_parcels,
        deposit.junk_parcels
    ));
    notes.extend(noise(&deposit));
    Ok((fuel, field, deposit, notes))
}

/// The coefficients of a spray in the scene's band.
fn spectral(
    made: Made<'_>,
    band: Option<&BandSource>,
    options: &OpticsOptions,
) -> Result<(MediumSource, OpticsReport, Vec<String>), SceneError> {
    let Made { scene, kind, fuel, field, mut notes, truncate_deg } = made;
    let wrong = |problem: String| meaning(scene, problem);
    let band = band.ok_or_else(|| {
        wrong(format!("[medium] kind {kind:?} needs a [band]: its coefficients depend on the wavelength"))
    })?;
    let absorbers = Absorbers {
        liquid: !field.deposit_parcel.is_empty(),
        vapour: field.gas.iter().any(|gas| gas.vapour_mol_m3 > 0.0),
    };
    let samples = samples(band, &fuel, absorbers, &mut notes).map_err(wrong)?;
    notes.extend(outside(&fuel, &samples));
    let sources = [Source::UNIT, Source::RADIANCE];
    let Optics { mut medium, report, .. } = optics::optics(&field, &fuel, &samples, &sources, options);
    notes.push(format!(
        "optics: {} Mie calculations, {} temperatures of the vapour, {} phase functions in {} groups",
        report.mie_spheres,
        report.vapour_nodes,
        report.phase_tables,
        samples.len()
    ));
    for skip in &report.skipped {
        notes.push(format!(
            "optics: skipped {} in {} groups: {}; a coefficient is off by at most {:.1e}",
            skip.work.name(),
            skip.groups,
            skip.reason,
            skip.admitted_error
        ));
    }
    if let Some(degrees) = truncate_deg {
        let cuts: Vec<Truncation> = medium
            .phase
            .iter()
            .map(|phase| cut(phase, degrees))
            .collect::<Result<_, _>>()
            .map_err(|problem| wrong(format!("[medium] {problem}")))?;
        thin(&mut medium, &cuts);
        notes.push(told(&cuts.iter().collect::<Vec<_>>(), degrees));
    }
    Ok((MediumSource::Spectral(Box::new(medium), samples), report, notes))
}

/// What the picture owes to the number of parcels.
fn noise(report: &DepositReport) -> Vec<String> {
    if report.droplet_cells == 0 {
        return Vec::new();
    }
    let [x, y, z] = report.split_half;
    let mut notes = vec![format!(
        "parcels: the droplets' density rests on N_eff = {:.0} parcels in kernels of {:.2e} m; two halves of the parcels \
         differ by {x:.3}, {y:.3}, {z:.3} in transmission seen along x, y, z, and the whole errs by half of that",
        report.n_eff, report.kernel_m
    )];
    if report.kinds > 0 {
        notes.push(format!(
            "parcels: there are so many that {} kinds of droplets stand for them",
            report.kinds
        ));
    }
    let worst = report.split_half.into_iter().fold(0.0, f64::max);
    if worst > DepositOptions::default().noise_max {
        notes.push(format!(
            "parcels: there are too few for a quiet picture ({worst:.3} where {} is wanted): compute with more",
            DepositOptions::default().noise_max
        ));
    }
    notes
}

/// What the user should know when the band reaches beyond the table of the liquid.
fn outside(fuel: &Fuel, band: &Band) -> Option<String> {
    let [from, to] = fuel.liquid_range_um();
    let beyond = band.wavelengths_um.iter().filter(|um| !(from..=to).contains(um)).count();
    (beyond > 0).then(|| {
        format!(
            "fuel {}: {beyond} of {} wavelengths of the band lie outside the liquid's table ({from:.3} to {to:.3} um); \
             its ends are used there",
            fuel.name(),
            band.len()
        )
    })
}

/// The spectral groups of a fuel in a band.
fn samples(
    band: &BandSource,
    fuel: &Fuel,
    absorbers: Absorbers,
    notes: &mut Vec<String>,
) -> Result<Band, String> {
    let samples = match band {
        BandSource::Wavelength(um) => Band::monochromatic(*um),
        BandSource::Response { response, samples: Samples::Number(n), .. } => {
            Band::sample(response, *n, true).map_err(|e| format!("[band] samples: {e}"))?
        }
        BandSource::Response { response, samples: Samples::Automatic, .. } => {
            let chosen = Band::automatic_for(response, fuel, absorbers, EMISSIVITY_ERROR)
                .map_err(|e| format!("[band] samples: {e}"))?;
            notes.push(format!(
                "band: {} groups, {} of them for the leak, error of column emissivities {:.1e}, of black-body signals \
                 {:.1e}",
                chosen.band.len(),
                chosen.band.leak_from.map_or(0, |leak| chosen.band.len() - leak),
                chosen.emissivity_error,
                chosen.signal_error
            ));
            chosen.band
        }
    };
    if samples.len() > GROUPS_MAX {
        return Err(format!(
            "[band] samples: {} spectral groups are needed, the tracer takes {GROUPS_MAX}; give a smaller number",
            samples.len()
        ));
    }
    Ok(samples)
}

/// Where the spray is put: as it is unless something about its place is said.
fn placement(source: &CfdSource) -> Result<Option<Placement>, import::SceneError> {
    let said = source.tip_m.or(source.axis).or(source.scene_tip_m).or(source.scene_axis);
    if said.is_none() && source.turn_deg.abs() < f64::MIN_POSITIVE {
        return Ok(None);
    }
    let down = [0.0, 0.0, -1.0];
    // Without a direction of its own the spray is not turned.
    let scene_axis = source.scene_axis.unwrap_or(down);
    Placement::new(Move {
        tip_m: source.tip_m.unwrap_or([0.0; 3]),
        axis: source.axis.unwrap_or(scene_axis),
        scene_tip_m: source.scene_tip_m.unwrap_or([0.0; 3]),
        scene_axis,
        turn_rad: source.turn_deg.to_radians(),
    })
    .map(Some)
}
