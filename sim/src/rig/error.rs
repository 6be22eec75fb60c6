//! What can be wrong with the description of a simulated world.

/// A simulated world that cannot be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RigError {
    /// simulated rig: reading the configuration: `key` has an impossible value.
    #[error("simulated rig: reading the configuration: {key}: {why}. Correct this key of the campaign file.")]
    Config {
        /// Key, dotted from `rig`.
        key: String,
        /// What is wrong with it.
        why: String,
    },
    /// simulated rig: joining rendered images: their shapes do not fit each other or the band.
    #[error(
        "simulated rig: joining rendered images: {why}. Render all density scales with one scene and band."
    )]
    Shape {
        /// Which shapes, found and expected.
        why: String,
    },
    /// simulated rig: `doing`: the network, or the camera to be put on it, refuses.
    #[error("simulated rig: {doing}: {why}. {hint}")]
    Network {
        /// The act.
        doing: String,
        /// What the system or the camera said.
        why: String,
        /// What to try.
        hint: String,
    },
}
