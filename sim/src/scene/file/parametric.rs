//! A parametric spray as a medium: `[medium] kind = "multi-hole"` and `"hollow-cone"`.

use super::SceneError;
use crate::light::fuel::Fuel;
use crate::scene::library;
use crate::scene::spray::description::{Injector, SpraySource};
use crate::scene::spray::{self, ParametricSpray};
use std::path::{Path, PathBuf};

/// A parametric spray as the scene describes it.
#[derive(Debug, Clone, PartialEq)]
pub struct ParametricSource {
    /// What the scene says.
    pub spray: SpraySource<Injector>,
    /// The scene file, for messages.
    pub scene: PathBuf,
}

impl ParametricSource {
    /// The fuel and the spray made of it.
    ///
    /// # Errors
    ///
    /// [`SceneError::Meaning`] with the line of the value at fault.
    pub fn made(&self) -> Result<(Fuel, ParametricSpray), SceneError> {
        let folder = self.scene.parent().unwrap_or(Path::new(""));
        let made = library::fuel(&self.spray.fuel, folder)
            .map_err(|e| format!("[medium] fuel: {e}"))
            .and_then(|fuel| spray::spray(&self.spray, &fuel).map(|made| (fuel, made)));
        made.map_err(|problem| {
            let text = std::fs::read_to_string(&self.scene).unwrap_or_default();
            SceneError::Meaning {
                path: self.scene.clone(),
                line: super::line_of(&text, 0, &problem),
                problem,
            }
        })
    }
}
