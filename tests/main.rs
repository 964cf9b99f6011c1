//! The tests of the whole program and of the library as a user sees it, in one binary: it is linked once.
//!
//! | theme | files |
//! | --- | --- |
//! | runs of the command | [`run`], [`photos`], [`gloss`], [`metal`], [`sheen`], [`tilt`], [`detail`], [`ggx`], [`scale`], [`priors`], [`light_frame`], [`export`], [`view_page`], [`report`], [`shown`], [`env`], [`scores`], [`benchmarks`], [`profile`], [`shade_cases`], [`json_log`], [`jobs`], [`ranks`] |
//! | what is written where, and what never is; runs that are stopped, or looked at | [`outputs`], [`resume`], `stop`, [`live`] |
//! | late failures, nonsense, edges; what a scene may not read | [`trust`], [`confined`], [`guard`] |
//! | what is refused, and how | [`agree`], [`bad_input`], [`check`], [`hostile`], [`mutants`], [`scene_errors`] |
//! | systems in a world, pictures | [`ecs`], [`swap`], [`visibility`], [`frames`], [`films`] |
//! | the documentation, the layers of the code | [`docs`], [`rooms`] |

mod common;

mod agree;
mod bad_input;
mod benchmarks;
mod check;
mod confined;
mod detail;
mod docs;
mod ecs;
mod env;
mod export;
mod films;
mod frames;
mod ggx;
mod gloss;
mod guard;
mod hostile;
mod jobs;
mod json_log;
mod light_frame;
mod live;
mod metal;
mod mutants;
mod outputs;
mod photos;
mod placements;
mod priors;
mod profile;
mod ranks;
mod report;
mod resume;
mod rooms;
mod run;
mod scale;
mod scene_errors;
mod scores;
mod shade_cases;
mod sheen;
mod shown;
#[cfg(unix)]
mod stop;
mod swap;
mod tilt;
mod trust;
mod view_page;
mod visibility;
