//! Features of a GigE camera by name: asked for, read, written.

use super::device::{Device, refused};
use super::names::Purpose;
use crate::error::DriverError;
use aravis::GcFeatureNode;
use aravis::glib::object::Cast;
use aravis::prelude::*;

impl Device {
    fn node(&self, name: &str) -> Option<GcFeatureNode> {
        self.camera.device()?.feature(name)?.downcast::<GcFeatureNode>().ok()
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.camera.is_feature_available(name).unwrap_or(false)
    }

    pub(super) fn read(&self, name: &str) -> Result<String, aravis::glib::Error> {
        match self.node(name) {
            Some(node) => node.value_as_string().map(|text| text.to_string()),
            None => self.camera.string(name).map(|text| text.to_string()),
        }
    }

    pub(super) fn write_purpose(
        &self,
        purpose: Purpose,
        value: Option<&str>,
        doing: &str,
    ) -> Result<(), DriverError> {
        let Some(name) = self.names.of(purpose) else { return Ok(()) };
        let Some(value) = value.or_else(|| self.names.value_of(purpose)) else { return Ok(()) };
        if !self.names.is_required(purpose) && !self.has(name) {
            return Ok(());
        }
        self.write(name, value, doing)
    }

    pub(super) fn write(&self, name: &str, value: &str, doing: &str) -> Result<(), DriverError> {
        super::names::refuse_forbidden(name)
            .map_err(|why| refused(&self.who, doing, &why, "Take it out of [camera.gige]."))?;
        let Some(node) = self.node(name) else {
            return Err(refused(
                &self.who,
                doing,
                &format!("it has no feature {name}"),
                "`ditd probe` lists what it has; give its name under [camera.gige.features].",
            ));
        };
        node.set_value_from_string(value).map_err(|error| {
            let bounds = self.camera.float_bounds(name).ok();
            let bounds = bounds.map(|(low, high)| format!(" (it takes {low} to {high})")).unwrap_or_default();
            self.trouble(&format!("{doing}: {name} = {value}{bounds}"), &error)
        })
    }
}
