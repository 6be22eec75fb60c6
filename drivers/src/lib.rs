//! How the instruments of a DIT rig talk.
//!
//! Wires, codecs and drivers, and the traits that a campaign commands. Knows no physics: what a plate or a
//! detector does lies in `ditd-sim`, what the numbers mean in `ditd`.

pub mod error;
pub mod fluke_418x;
pub mod instrument;
mod keyword;
pub mod quantity;
pub mod quantum_9520;
pub mod wire;
