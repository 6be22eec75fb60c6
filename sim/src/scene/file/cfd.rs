//! A CFD spray as a medium: the place where import, deposit and optics are joined.

use super::phase::{cut, thin, told};
use super::{BandSource, CfdSource, MediumSource, Samples, Scene, SceneError};
use crate::light::band::{Absorbers, Band};
use crate::light::fuel::Fuel;
use crate::light::phase::truncation::Truncation;
use crate::scene::deposit::{self, DepositOptions, DepositReport, Move, Placement, Sectors};
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
    /// Imports the scene's CFD spray, if it has one, for a purpose, and says in its notes how. Other scenes stay as they
    /// are.
    ///
    /// # Errors
    ///
    /// [`SceneError`] for a spray that cannot be read, an unknown fuel, or a scene without band.
    pub fn with_spray(mut self, options: &OpticsOptions) -> Result<Self, SceneError> {
        if let Some(MediumSource::Cfd(source)) = &self.medium {
            let made = spectral(source, self.band.as_ref(), options)?;
            self.medium = Some(made.medium);
            self.optics = Some(made.optics);
            self.deposit = Some(made.deposit);
            self.notes.extend(made.notes);
        }
        Ok(self)
    }
}

/// A spray made a medium.
struct Made {
    medium: MediumSource,
    optics: OpticsReport,
    deposit: DepositReport,
    notes: Vec<String>,
}

fn spectral(
    source: &CfdSource,
    band: Option<&BandSource>,
    options: &OpticsOptions,
) -> Result<Made, SceneError> {
    let text = std::fs::read_to_string(&source.scene).unwrap_or_default();
    let wrong = |problem: String| SceneError::Meaning {
        path: source.scene.clone(),
        line: super::line_of(&text, 0, &problem),
        problem,
    };
    let unread = |e| SceneError::Spray { path: source.scene.clone(), source: Box::new(e) };
    let band = band.ok_or_else(|| {
        wrong("[medium] kind \"cfd\" needs a [band]: its coefficients depend on the wavelength".to_owned())
    })?;
    let folder = source.scene.parent().unwrap_or(Path::new(""));
    let fuel = library::fuel(&source.fuel, folder).map_err(|e| wrong(format!("[medium] fuel: {e}")))?;
    let mut notes = Vec::new();
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
    let absorbers = Absorbers { liquid: deposit.droplet_cells > 0, vapour: deposit.vapour_cells > 0 };
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
    if let Some(degrees) = source.truncate_deg {
        let cuts: Vec<Truncation> = medium
            .phase
            .iter()
            .map(|phase| cut(phase, degrees))
            .collect::<Result<_, _>>()
            .map_err(|problem| wrong(format!("[medium] {problem}")))?;
        thin(&mut medium, &cuts);
        notes.push(told(&cuts.iter().collect::<Vec<_>>(), degrees));
    }
    let medium = MediumSource::Spectral(Box::new(medium), samples);
    Ok(Made { medium, optics: report, deposit, notes })
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
