//! Whether a described spray is one that the model was made for.

use super::description::{Injector, SpraySource};

/// Most holes of an injector.
const HOLES_MAX: u32 = 64;

/// A value that must lie in a range, with what to try.
struct Bound<'a> {
    table: &'a str,
    key: &'a str,
    value: f64,
    range: [f64; 2],
    unit: &'a str,
}

impl SpraySource<Injector> {
    /// Whether every value is one that the model was made for; the message begins with its table.
    ///
    /// # Errors
    ///
    /// In words: table, key, value, and what is allowed.
    pub fn check(&self) -> Result<(), String> {
        let mut bounds = vec![
            Bound { table: "medium", key: "time_s", value: self.time_s, range: [1e-6, 0.02], unit: "s" },
            Bound {
                table: "medium.gas",
                key: "pressure_pa",
                value: self.gas.pressure_pa,
                range: [2e4, 2e6],
                unit: "Pa",
            },
            Bound {
                table: "medium.gas",
                key: "temperature_k",
                value: self.gas.temperature_k,
                range: [280.0, 700.0],
                unit: "K",
            },
            Bound {
                table: "medium.plume",
                key: "angle_coefficient",
                value: self.plume.angle_coefficient,
                range: [0.01, 3.0],
                unit: "",
            },
        ];
        let mut optional = |table, key, value: Option<f64>, range, unit| {
            bounds.extend(value.map(|value| Bound { table, key, value, range, unit }));
        };
        optional("medium", "cell_m", self.cell_m, [2e-5, 0.02], "m");
        optional("medium.plume", "angle_deg", self.plume.angle_deg, [1.0, 90.0], "degrees");
        optional("medium.droplets", "sauter_mean_m", self.droplets.sauter_mean_m, [5e-7, 5e-4], "m");
        optional("medium.droplets", "spread", self.droplets.spread, [1.3, 20.0], "");
        let shots = &self.shots;
        for (key, value, range, unit) in [
            ("turbulence", shots.turbulence, [0.0, 2.0], ""),
            ("integral_scale", shots.integral_scale, [0.005, 1.0], ""),
            ("mass", shots.mass, [0.0, 1.0], ""),
            ("angle_deg", shots.angle_deg, [0.0, 10.0], "degrees"),
        ] {
            bounds.push(Bound { table: "medium.shots", key, value, range, unit });
        }
        self.injector_bounds(&mut bounds);
        for Bound { table, key, value, range: [from, to], unit } in bounds {
            if !(from..=to).contains(&value) {
                return Err(format!("[{table}] {key} is {value}; it must be {from} to {to} {unit}")
                    .trim_end()
                    .to_owned());
            }
        }
        self.check_together()
    }

    fn injector_bounds<'a>(&self, bounds: &mut Vec<Bound<'a>>) {
        let table = "medium.injector";
        let mut push = |key, value, range, unit| bounds.push(Bound { table, key, value, range, unit });
        match self.injector {
            Injector::MultiHole(i) => {
                push("holes", f64::from(i.holes), [1.0, f64::from(HOLES_MAX)], "");
                push("hole_diameter_m", i.hole_diameter_m, [2e-5, 2e-3], "m");
                push("pitch_circle_m", i.pitch_circle_m, [0.0, 0.05], "m");
                push("angle_deg", i.angle_deg, [0.0, 89.0], "degrees");
                push("first_azimuth_deg", i.first_azimuth_deg, [-360.0, 360.0], "degrees");
            }
            Injector::HollowCone(i) => {
                push("pintle_diameter_m", i.pintle_diameter_m, [1e-4, 0.05], "m");
                push("cone_angle_deg", i.cone_angle_deg, [5.0, 175.0], "degrees");
                push("sheet_thickness_m", i.sheet_thickness_m, [2e-6, 1e-3], "m");
            }
        }
        let feed = self.injector.feed();
        push("discharge_coefficient", feed.discharge_coefficient, [0.05, 1.0], "");
        push("velocity_coefficient", feed.velocity_coefficient, [0.05, 1.0], "");
        push("rail_pressure_pa", feed.rail_pressure_pa, [1e5, 5e8], "Pa");
        push("duration_s", feed.duration_s, [1e-6, 0.1], "s");
    }

    fn check_together(&self) -> Result<(), String> {
        let feed = self.injector.feed();
        if self.axis.iter().chain(&self.tip_m).any(|x| !x.is_finite()) {
            return Err("[medium] tip_m and axis must be finite numbers".to_owned());
        }
        if self.axis.iter().map(|x| x * x).sum::<f64>().sqrt() < 1e-9 {
            return Err(
                "[medium] axis must not be [0, 0, 0]; give the direction the injector points to".to_owned()
            );
        }
        if feed.rail_pressure_pa < 2.0 * self.gas.pressure_pa {
            return Err(format!(
                "[medium.injector] rail_pressure_pa is {}; it must be at least twice the gas's pressure, {} Pa: below \
                 that it is no spray",
                feed.rail_pressure_pa, self.gas.pressure_pa
            ));
        }
        if feed.discharge_coefficient > feed.velocity_coefficient {
            return Err(format!(
                "[medium.injector] discharge_coefficient is {}; it cannot exceed velocity_coefficient, {}: their \
                 ratio is the contraction of the jet",
                feed.discharge_coefficient, feed.velocity_coefficient
            ));
        }
        if !["N2", "n2", "nitrogen"].contains(&self.gas.species.as_str()) {
            return Err(format!(
                "[medium.gas] species {:?}: there are properties of \"N2\" only; it stands in well for air",
                self.gas.species
            ));
        }
        Ok(())
    }
}
