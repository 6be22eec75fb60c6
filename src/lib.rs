//! How an experiment is run and read.
//!
//! In reading order: what the user asks for, what will be done, doing it, the record of it, what the record
//! says, and how it is shown. Data goes right, only commands go left.

pub mod soak;
pub mod campaign;
pub mod commands;
pub mod samples;
pub mod config;
pub mod estimate;
pub mod files;
pub mod journal;
pub mod reduce;
pub mod calibrate;
pub mod run_folder;
pub mod plan;
pub mod report;
pub mod console;
pub mod interrupt;
pub mod stack;
