//! How an experiment is run and read.
//!
//! In reading order: what the user asks for, what will be done, doing it, the record of it, what the record
//! says, and how it is shown. Data goes right, only commands go left.

pub mod config;
pub mod samples;
pub mod plan;
pub mod soak;
pub mod campaign;
pub mod rigs;
pub mod journal;
pub mod run_folder;
pub mod archive;
pub mod reduce;
pub mod calibrate;
pub mod estimate;
pub mod expectation;
pub mod fitting;
pub mod truth;
pub mod result;
pub mod session;
pub mod stack;
pub mod import_frames;
pub mod materials;
pub mod tables;
pub mod files;
pub mod report;
pub mod clock;
pub mod console;
pub mod doctor;
pub mod interrupt;
pub mod commands;
