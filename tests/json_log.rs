//! `lobelia run --log json`: events for programs.

use crate::common::{Data, Outcome, scene};
use serde_json::Value;

fn events(outcome: &Outcome) -> Vec<Value> {
    outcome.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn every_line_is_an_event_and_the_last_says_how_it_ended() {
    let data = Data::new();
    let text = scene(r#"Fit(name: "fit", steps: 10, batch: 256), Render(name: "novel"), Save(),"#);
    let events = events(&data.run(&text, "out", &["--log", "json"]).succeeded());
    let of = |kind: &str| events.iter().filter(|event| event["event"] == kind).collect::<Vec<_>>();
    let passes: Vec<&str> = of("pass").iter().map(|pass| pass["name"].as_str().unwrap()).collect();
    assert_eq!(passes, ["fit", "novel", "saved"]);
    assert!(of("pass").iter().all(|pass| pass["count"] == 3));
    assert!(
        of("stage").iter().any(|stage| stage["title"] == "photographs" && stage["length"].as_u64() > Some(0))
    );
    assert!(of("progress").iter().any(|at| at["title"] == "fit" && at["message"] == "first guess"));
    assert!(of("progress").iter().all(|at| at["length"] == 0 || at["message"] != "first guess"));
    assert_eq!(of("stage").len(), of("done").len(), "every task that begins ends");
    assert!(of("done").iter().any(|task| task["title"] == "fit" && task["done"] == 10));
    assert!(of("result").iter().any(|line| line["text"].as_str().unwrap().contains("10 steps")));
    let steps = of("step");
    assert!(steps.len() == 1 && steps[0]["step"] == 10 && steps[0]["steps"] == 10, "{steps:?}");
    assert!(steps[0]["psnr"].as_f64() > Some(5.0) && steps[0]["lobes"].as_u64() > Some(0), "{steps:?}");
    let pictures: Vec<&str> = of("picture").iter().map(|at| at["path"].as_str().unwrap()).collect();
    assert!(
        pictures.len() == 1 && pictures[0].ends_with(".png") && std::path::Path::new(pictures[0]).exists()
    );
    let secs: Vec<f64> = events.iter().map(|event| event["secs"].as_f64().unwrap()).collect();
    assert!(secs.windows(2).all(|pair| pair[0] <= pair[1]), "{secs:?}");
    let ended = of("ended");
    assert!(ended.len() == 1 && ended[0]["state"] == "finished" && ended[0]["error"].is_null(), "{ended:?}");
    assert_eq!(ended[0], events.last().unwrap());
}

#[test]
fn what_fails_before_the_first_pass_is_an_event_too() {
    let data = Data::new();
    let outcome = data.run("Scene(version: 1)", "out", &["--log", "json"]);
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    let events = events(&outcome);
    assert!(events.len() == 1 && events[0]["state"] == "failed", "{events:?}");
    assert!(events[0]["error"].as_str().unwrap().contains("scene.ron"), "{events:?}");
    assert!(outcome.stderr.starts_with("error: "), "{}", outcome.stderr);
    let both = data.run(&scene("Save(),"), "out", &["--log", "json", "--quiet"]);
    assert_eq!(both.code, Some(2), "{}", both.stderr);
}
