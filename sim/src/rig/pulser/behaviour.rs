//! What a trigger unit is, and what goes wrong with it, its line and its outputs.

use crate::rig::line::{LineFault, check_seconds};
use ditd_drivers::quantum_9520::UnitError;
use serde::{Deserialize, Serialize};

/// What a trigger unit does wrong, besides its line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum TriggerFault {
    /// One trigger of the camera is missing.
    DropsCameraPulse {
        /// Which, counted from 0 over the unit's whole life.
        pulse: u64,
    },
    /// One trigger of the camera comes twice: a contact that bounces, a neighbour that couples in.
    DoublesCameraPulse {
        /// Which, counted from 0 over the unit's whole life.
        pulse: u64,
        /// How much later the second one comes, in seconds.
        after_s: f64,
    },
    /// The unit says that it runs, and nothing leaves its outputs.
    DropsAllPulses {
        /// Since when, in seconds of the rig's clock.
        from_s: f64,
    },
    /// A command is answered by an error (a 9520), or puts one into the error queue (a DG645: illegal value).
    Refuses {
        /// Start of the command in the manual's spelling, such as `:PULSE2:STATE 1` or `BURC`.
        command: String,
        /// The answer of a 9520.
        #[serde(default = "unavailable")]
        error: UnitError,
    },
    /// A command that sets something is taken without complaint and not obeyed.
    Ignores {
        /// Start of the command in the manual's spelling.
        command: String,
    },
    /// Its power fails: outputs at rest, settings as delivered, no answer until it has booted again.
    Reboots {
        /// When, in seconds of the rig's clock.
        at_s: f64,
        /// How long it boots, in seconds.
        boot_s: f64,
    },
    /// Its line is pulled for good; what it was told last it goes on with.
    LinePulled {
        /// When, in seconds of the rig's clock.
        at_s: f64,
    },
}

fn unavailable() -> UnitError {
    UnitError::Unavailable
}

impl TriggerFault {
    fn check(&self) -> Result<(), String> {
        match self {
            Self::DropsAllPulses { from_s } => check_seconds("from_s", *from_s),
            Self::DoublesCameraPulse { after_s, .. } => check_seconds("after_s", *after_s),
            Self::Reboots { at_s, boot_s } => {
                check_seconds("at_s", *at_s).and_then(|()| check_seconds("boot_s", *boot_s))
            }
            Self::LinePulled { at_s } => check_seconds("at_s", *at_s),
            Self::DropsCameraPulse { .. } | Self::Refuses { .. } | Self::Ignores { .. } => Ok(()),
        }
    }
}

/// What a trigger unit is and how its line behaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PulserBehaviour {
    /// Time of one command, in seconds.
    #[serde(default = "PulserBehaviour::command_s")]
    pub command_s: f64,
    /// Time from the start of the rig's clock until the unit has booted, in seconds.
    #[serde(default)]
    pub boot_s: f64,
    /// It was left with its echo on (a 9520).
    #[serde(default)]
    pub echo: bool,
    /// What goes wrong on the line; nothing when absent.
    #[serde(default)]
    pub line_faults: Vec<LineFault>,
    /// What else goes wrong; nothing when absent.
    #[serde(default)]
    pub faults: Vec<TriggerFault>,
}

impl PulserBehaviour {
    /// A unit as delivered, booted.
    pub fn delivered() -> Self {
        Self {
            command_s: Self::command_s(),
            boot_s: 0.0,
            echo: false,
            line_faults: Vec::new(),
            faults: Vec::new(),
        }
    }

    /// Whether the behaviour can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        check_seconds("command_s", self.command_s)?;
        check_seconds("boot_s", self.boot_s)?;
        self.line_faults.iter().try_for_each(LineFault::check)?;
        self.faults.iter().try_for_each(TriggerFault::check)
    }

    /// 9520 manual, chapter 7: about 10 ms a command; the same is assumed of a DG645.
    fn command_s() -> f64 {
        0.010
    }

    /// What the faults do to a command, given in the manual's spelling.
    pub(in crate::rig) fn meddling(&self, spelled: &str, is_set: bool) -> Option<Meddling> {
        let starts = |prefix: &String| {
            spelled.get(..prefix.len()).is_some_and(|start| start.eq_ignore_ascii_case(prefix))
        };
        self.faults.iter().find_map(|fault| match fault {
            TriggerFault::Refuses { command, error } if starts(command) => Some(Meddling::Refused(*error)),
            TriggerFault::Ignores { command } if is_set && starts(command) => Some(Meddling::Ignored),
            _ => None,
        })
    }
}

/// What a fault does to a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::rig) enum Meddling {
    Refused(UnitError),
    Ignored,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_behaviour_is_read_from_a_file_and_unknown_keys_are_refused() {
        let text = "boot_s = 2.0\n[[faults]]\nkind = \"drops-camera-pulse\"\npulse = 3\n\
                    [[faults]]\nkind = \"refuses\"\ncommand = \":PULSE0:STATE\"\nerror = \"unavailable\"\n\
                    [[faults]]\nkind = \"refuses\"\ncommand = \"BURC\"\n\
                    [[faults]]\nkind = \"reboots\"\nat_s = 1.0\nboot_s = 3.0\n\
                    [[line_faults]]\nkind = \"silent\"\nfrom_s = 9.0\n";
        let behaviour: PulserBehaviour = toml::from_str(text).unwrap();
        assert_eq!(behaviour.faults.len(), 4);
        assert_eq!(behaviour.line_faults, [LineFault::Silent { from_s: 9.0 }]);
        assert_eq!(toml::from_str::<PulserBehaviour>("").unwrap(), PulserBehaviour::delivered());
        assert!(toml::from_str::<PulserBehaviour>("colour = 1\n").is_err());
        for (text, key) in [
            ("boot_s = nan\n", "boot_s"),
            ("[[faults]]\nkind = \"line-pulled\"\nat_s = -1.0\n", "at_s"),
            ("[[faults]]\nkind = \"doubles-camera-pulse\"\npulse = 1\nafter_s = inf\n", "after_s"),
        ] {
            let impossible: PulserBehaviour = toml::from_str(text).unwrap();
            assert!(impossible.check().unwrap_err().starts_with(key), "{text}");
        }
    }
}
