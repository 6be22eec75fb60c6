//! Inverse Abel transform: from columns along straight sights to the local coefficient of a medium that is round about a
//! vertical axis. Arrays in, arrays out.
//!
//! p(y) = 2 ∫ f(r) r/√(r² − y²) dr is turned round row by row by one of several linear methods, or the one that allows no
//! negative values. The halves of a row are joined by their variances; variances go through exactly, with the squares of
//! the operator. What is missing stays missing only where it must. Knows nothing of files and of what the columns are; see
//! [`super::column`] for columns from emissivities and [`emission`] for temperatures.
//!
//! In reading order: what a caller says (`request`) and gets (`inverted`), the operators of a width (`inverter`) and their
//! answers (`answer`, `unfold`), rows (`rows`), the axis (`centre`), radii and pixels (`grid`), halves (`fold`), the
//! operators (`operators`) and those with a strength (`filtered`, `choose`), bounds (`bounded`), rows that are not
//! complete (`single`, `alone`), matrices (`matrix`), temperatures (`emission`).

mod alone;
mod answer;
mod bank;
mod bounded;
pub mod centre;
mod choose;
mod elements;
pub mod emission;
mod filtered;
pub mod flag;
mod fold;
mod grid;
mod inverted;
mod inverter;
mod matrix;
mod operator;
mod operators;
mod product;
mod request;
mod rows;
mod single;
mod singles;
#[cfg(test)]
mod tests;
mod unfold;

pub use choose::Strength;
pub use inverted::Inverted;
pub use inverter::{Inverter, Memory, invert};
pub use request::{AbelError, Columns, Elements, Method, Settings};
