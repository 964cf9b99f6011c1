//! The survey as text, JSON and a contact sheet; and the estimate.

use super::{good, object, surveyed};
use crate::report::sheet::{SheetCell, compose};
use crate::scene::{FitPass, LoadOptions, Pass, Scene, ShapePass, load};
use crate::survey::estimate::{Estimate, Workers, duration, estimate, memory};
use crate::survey::finding::named;
use crate::survey::{Survey, contact_sheet, json, table};
use glam::Vec3;

fn scene(passes: &str) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ron");
    let text = format!(
        "Scene(version: 1, surface: Sphere(texture_size: 256), light: Unknown(lobes: 64), \
         views: Dataset(path: \".\"), passes: [{passes}])"
    );
    std::fs::write(&path, text).unwrap();
    load(&path, &LoadOptions::default()).unwrap().scene
}

fn with_a_black_view() -> Survey {
    let mut views = good();
    views[4].photograph.as_mut().unwrap().image.pixels.fill(Vec3::ZERO);
    surveyed(&views, Some(&object()))
}

#[test]
fn the_table_says_what_there_is() {
    let survey = surveyed(&good(), Some(&object()));
    let rows = table::rows(&survey);
    let text = |label: &str| rows.iter().find(|row| row.0 == label).unwrap().1.clone();
    assert!(text("data").contains("20 training views of 96×96, 4 test views of 96×96"), "{}", text("data"));
    assert!(text("masks").starts_with("files of 24 views; the object covers"), "{}", text("masks"));
    assert!(
        text("cameras").starts_with("all around, from above and below: elevation -"),
        "{}",
        text("cameras")
    );
    assert!(text("overlap").contains("overlap to 1.000"), "{}", text("overlap"));
    assert!(text("light").contains("clipped 0.00 %"), "{}", text("light"));
    assert_eq!(
        (table::verdict(Some(&survey), 0), table::findings(&survey)),
        ("fine".to_owned(), String::new())
    );
    let black = with_a_black_view();
    assert_eq!(
        (table::verdict(Some(&black), 0), table::verdict(None, 1)),
        ("1 error".into(), "1 error".into())
    );
    assert_eq!(table::findings(&black), "", "the first error is what the program ends with");
}

#[test]
fn json_and_sheet_flag_the_view() {
    let survey = with_a_black_view();
    let value = json::value(&survey, &Estimate::default());
    assert_eq!(value["findings"][0]["name"], "black");
    assert_eq!(value["views"][4]["flags"][0], "black");
    assert_eq!(value["views"][5]["flags"].as_array().unwrap().len(), 0);
    assert_eq!(value["cameras"]["kind"], "sphere");
    let sheet = contact_sheet::contact_sheet(&survey, "a scene");
    let labels: Vec<&str> =
        sheet.rows.iter().flat_map(|row| &row.cells).map(|cell| cell.label.as_str()).collect();
    assert!(
        labels.contains(&"v4: black") && labels.contains(&"v5") && labels.contains(&"t0 (test)"),
        "{labels:?}"
    );
    assert!(labels.contains(&"from above"), "{labels:?}");
    let picture = compose(&sheet).unwrap();
    assert!(picture.width() > 8 * 152 && picture.height() > 3 * 152, "{:?}", picture.dimensions());
    let outlined =
        |cell: &&SheetCell| cell.image.pixels().filter(|pixel| pixel.0 == [255, 40, 160]).count() > 40;
    assert_eq!(sheet.rows.iter().flat_map(|row| &row.cells).filter(outlined).count(), 24);
}

#[test]
fn more_work_takes_more_time_and_memory() {
    let survey = surveyed(&good(), Some(&object()));
    let render = "Render(name: \"novel\")";
    let of = |passes: &str, threads| estimate(&survey.looks, &scene(passes), Workers::threads(threads));
    let short = of(&format!("Fit(steps: 100), {render}"), 2);
    let long = of(&format!("Fit(steps: 1000), {render}"), 2);
    assert!(long.seconds() > short.seconds() && long.bytes() == short.bytes());
    assert!(of("Fit(steps: 1000)", 4).seconds() < long.seconds());
    assert!(of("Fit()", 2).bytes() > of("", 2).bytes());
    let names: Vec<&str> = long.parts.iter().map(|part| part.what.as_str()).collect();
    assert_eq!(names, ["photographs", "texels", "shadows", "fit", "novel"]);
    // Everything is linear in what it says it is.
    let Pass::Fit(FitPass { batch, .. }) = &scene("Fit(steps: 1000)").passes[0] else { panic!() };
    // Half of the steps, before the first milestone, visit half of the pixels.
    let pairs = f64::from(*batch) * 900.0 * 0.75 * 64.0;
    let fit = |estimate: &Estimate| estimate.parts.iter().find(|part| part.what == "fit").unwrap().seconds;
    let longer = fit(&long) - fit(&short);
    assert!((longer - 0.5e-9 * pairs * crate::survey::estimate::FIT_PAIR_NANOS).abs() < 1e-6);
    // What comes before the first step takes time as well.
    assert!(fit(&short) > longer / 9.0);
    assert!(long.words().contains("on 2 threads"), "{}", long.words());
}

#[test]
fn processes_share_the_photographs_that_only_fits_look_at() {
    let survey = surveyed(&good(), Some(&object()));
    let photographs = |passes: &str, processes| {
        let workers = Workers { processes, ..Workers::threads(2) };
        estimate(&survey.looks, &scene(passes), workers).parts[0].bytes
    };
    let scored = |views: &str| {
        format!(
            "Fit(), Render(name: \"again\", render: (views: {views})), \
             Evaluate(scores: [(pass: \"again\", truth: Photographs)])"
        )
    };
    let (one, four) = (photographs("Fit()", 1), photographs("Fit()", 4));
    assert!(four < 0.6 * one, "{one} {four}");
    assert_eq!(photographs(&scored("Test"), 4), four);
    assert_eq!(photographs(&scored("All"), 4), one);
}

#[test]
fn levels_that_photographs_do_not_resolve_take_nothing() {
    let survey = surveyed(&good(), None);
    let of = |survey: &Survey, levels: usize| {
        let mut shape = ShapePass::default();
        shape.levels.truncate(levels);
        let scene = Scene { passes: vec![Pass::Shape(shape)], ..scene("") };
        let estimate = estimate(&survey.looks, &scene, Workers::threads(2));
        estimate.parts.into_iter().find(|part| part.what == "shape").unwrap()
    };
    let (two, three) = (of(&survey, 2), of(&survey, 3));
    assert_eq!((two.seconds, two.bytes), (three.seconds, three.bytes));
    let mut large = survey;
    large.looks.iter_mut().for_each(|look| look.size = [2048; 2]);
    assert!(of(&large, 3).seconds > of(&large, 2).seconds && of(&large, 3).bytes > of(&large, 2).bytes);
}

#[test]
fn numbers_and_names_are_short() {
    assert_eq!([memory(850.0 * 1048576.0), memory(2.5 * 1073741824.0)], ["850 MiB", "2.5 GiB"]);
    assert_eq!([duration(1.2), duration(300.0), duration(7200.0)], ["2 s", "5 min", "2.0 h"]);
    let views: Vec<String> = (0..7).map(|i| format!("v{i}")).collect();
    assert_eq!(named(&views[..1]), "view `v0`");
    assert_eq!(named(&views), "views `v0`, `v1`, `v2`, `v3`, `v4` and 2 more");
}
