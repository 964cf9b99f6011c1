//! To come.

pub mod shade_cases;
