//! Why a campaign ends before its end, in words and as an exit status.

use super::RecordError;
use crate::console::duration_words;
use ditd_drivers::error::DriverError;

/// Why a campaign did not reach its end.
#[derive(Debug, thiserror::Error)]
pub enum CampaignError {
    /// An instrument.
    #[error(transparent)]
    Driver(#[from] DriverError),
    /// The record.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The plate did not settle.
    #[error(
        "plate calibrator: level {level} ({target_k:.2} K) has not settled in {waited_s:.0} s: {reason}{}. \
         Compare [soak] with what the instrument can hold, and look for draughts.",
        remaining(.eta_s)
    )]
    NotSettled {
        /// Level number from 1.
        level: u32,
        /// Set-point in K.
        target_k: f64,
        /// Time waited in s.
        waited_s: f64,
        /// What was missing.
        reason: String,
        /// What it would still have taken, in s, where that can be guessed.
        eta_s: Option<f64>,
    },
    /// No frame came at all.
    #[error(
        "camera and trigger unit: no frame in {cycles} cycles of level {level}; the trigger unit says that it is {state}. \
         Check the trigger cable, the camera's trigger input and that the camera is armed."
    )]
    NoFrames {
        /// Level number from 1.
        level: u32,
        /// Silent cycles.
        cycles: u32,
        /// Running or not.
        state: &'static str,
    },
    /// Too many cycles had to be taken again.
    #[error(
        "level {level}: {rejected} cycles were rejected, more than the {allowed} that may be taken again; the last because {reason}. \
         Nothing was mislabelled; check camera, network and plate, then `ditd resume`."
    )]
    TooManyRetakes {
        /// Level number from 1.
        level: u32,
        /// Rejected cycles.
        rejected: u32,
        /// The limit.
        allowed: u32,
        /// Why the last one was rejected.
        reason: String,
    },
    /// The calibrator's protection has acted.
    #[error(
        "plate calibrator: its cutout has tripped at {apparent_k:.1} K. Find out why before clearing it at the instrument."
    )]
    Tripped {
        /// Display in K.
        apparent_k: f64,
    },
    /// A value of the world is outside a limit of the plan.
    #[error(
        "plate calibrator: {reading_k:.1} K is above the limit of {limit_k:.1} K. The plate is being cooled."
    )]
    TooHot {
        /// Display in K.
        reading_k: f64,
        /// Limit in K.
        limit_k: f64,
    },
    /// A process value is outside of a limit of the plan.
    #[error(
        "monitor: {name} is {value}, {side} its limit of {limit}. Bring the rig back to its limits, or change them in [[monitor]]."
    )]
    OutOfLimits {
        /// Monitor and value.
        name: String,
        /// What it is, in the unit of its name.
        value: f64,
        /// `above` or `below`.
        side: &'static str,
        /// The limit.
        limit: f64,
    },
    /// A mistake of ours inside the engine.
    #[error(
        "the campaign engine stopped on a broken assumption ({0}); the rig was brought to its safe state. Please report it."
    )]
    Internal(String),
}

fn remaining(eta_s: &Option<f64>) -> String {
    eta_s.map_or_else(String::new, |s| format!("; it would have taken about {} more", duration_words(s)))
}

impl CampaignError {
    /// The process's exit status that stands for it.
    pub fn code(&self) -> u8 {
        match self {
            Self::Driver(error) if error.is_interlock_or_limit() => 4,
            Self::Driver(error) if error.is_missing_device() => 3,
            Self::NoFrames { .. } => 3,
            Self::Tripped { .. } | Self::TooHot { .. } | Self::OutOfLimits { .. } => 4,
            Self::TooManyRetakes { .. } => 5,
            Self::Driver(_) | Self::Record(_) | Self::NotSettled { .. } | Self::Internal(_) => 1,
        }
    }
}
