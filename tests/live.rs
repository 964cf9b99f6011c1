//! Runs with a page (`--live`): what it shows, its button, who is refused, and that the run is the same.

use crate::common::{AtWork, Data, files_below, manifest, scene, states};
use crate::photos::photographs;
use crate::resume::results;
use serde_json::Value;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

const ENDLESS: &str = r#"Fit(name: "endless", steps: 1500000000, batch: 256), "#;

/// The page of a run, as a browser has it.
struct Page {
    port: u16,
    token: String,
}

/// The status and the text of an answer; `None` if there is none.
fn ask(port: u16, method: &str, path: &str, headers: &[(&str, &str)]) -> Option<(u16, String)> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
    let host = format!("127.0.0.1:{port}");
    let has_host = headers.iter().any(|(name, _)| *name == "Host");
    let own = [("Host", host.as_str())];
    let headers = own.iter().filter(|_| !has_host).chain(headers);
    let headers: String = headers.map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    stream.write_all(format!("{method} {path} HTTP/1.1\r\n{headers}\r\n").as_bytes()).ok()?;
    let mut text = String::new();
    stream.read_to_string(&mut text).ok()?;
    let (head, body) = text.split_once("\r\n\r\n")?;
    // The end of the process cuts an answer off.
    let length = head
        .lines()
        .find_map(|line| line.to_ascii_lowercase().strip_prefix("content-length:")?.trim().parse().ok());
    if length.is_some_and(|length: usize| body.len() < length) {
        return None;
    }
    Some((head.split(' ').nth(1)?.parse().ok()?, body.to_owned()))
}

impl Page {
    fn open(port: u16) -> Self {
        let (status, text) = ask(port, "GET", "/", &[]).unwrap();
        assert_eq!(status, 200, "{text}");
        let token = text.split("data-token=\"").nth(1).unwrap().split('"').next().unwrap().to_owned();
        Self { port, token }
    }

    #[track_caller]
    fn get(&self, path: &str) -> String {
        let (status, text) = ask(self.port, "GET", path, &[]).unwrap();
        assert_eq!(status, 200, "{path}: {text}");
        text
    }

    #[track_caller]
    fn press(&self, path: &str) -> Value {
        let (status, text) = ask(self.port, "POST", path, &[("X-Lobelia-Token", &self.token)]).unwrap();
        assert_eq!(status, 200, "{path}: {text}");
        serde_json::from_str(&text).unwrap()
    }

    /// Presses "renew" until the object is copied this often: on a busy machine a press may end before the next step.
    #[track_caller]
    fn until_copy(&self, number: u64) -> Value {
        let start = Instant::now();
        loop {
            let pressed = self.press("/renew");
            if pressed["copy"]["number"].as_u64().is_some_and(|at| at >= number) {
                return pressed["copy"].clone();
            }
            assert!(start.elapsed() < Duration::from_secs(300), "{pressed}");
        }
    }

    fn state(&self) -> Value {
        serde_json::from_str(&self.get("/state.json")).unwrap()
    }

    /// Waits for the step of this number.
    #[track_caller]
    fn until_step(&self, step: u64) -> Value {
        let start = Instant::now();
        loop {
            let state = self.state();
            if state["step"]["step"].as_u64().is_some_and(|at| at >= step) {
                return state;
            }
            assert!(start.elapsed() < Duration::from_secs(300), "{state}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

#[test]
fn a_fit_is_seen_while_it_works_and_ended_by_its_button() {
    let data = Data::new();
    let (at_work, port) = AtWork::begin_live(&data, &scene(&[ENDLESS, "Save(), "].concat()), &[]);
    let page = Page::open(port);
    let state = page.until_step(25);
    assert_eq!((state["state"].as_str(), state["pass"]["name"].as_str()), (Some("running"), Some("endless")));
    assert!(state["step"]["psnr"].is_number() && state["points"].as_u64() >= Some(2), "{state}");
    assert!(state["copy"].is_null(), "nothing is copied before somebody asks");
    let copied = page.until_copy(1);
    assert!(copied["at"].as_str().unwrap().starts_with("endless, step "), "{copied}");
    let object = page.get("/object.html");
    assert!(object.contains(r#"name="generator" content="Lobelia""#) && object.len() > 50_000);
    let views = page.get("/views.html");
    assert_eq!(views.matches("class=\"card\"").count(), 4, "{views}");
    assert!(views.matches("data:image/jpeg").count() == 12 && views.contains(" dB, SSIM "));
    let curves = page.get("/curves.html");
    assert!(curves.contains("Loss") && curves.contains("<polyline"), "{curves}");
    page.until_copy(copied["number"].as_u64().unwrap() + 1);

    refuses_others(&page);
    assert_eq!(page.press("/stop")["first"], true);
    // A terminal that is closed now ends nothing at once.
    #[cfg(unix)]
    at_work.signal("INT");
    assert_eq!(at_work.ended(), Some(130));
    let manifest = manifest(&data.path("out"));
    assert_eq!(
        (manifest["state"].as_str(), states(&manifest)),
        (Some("interrupted"), vec!["interrupted".into(), "finished".into()])
    );
    assert!(data.path("out/saved/scene.ron").exists());
}

/// Others than the page cannot stop the run, nor keep it from its work, nor the page from being served.
fn refuses_others(page: &Page) {
    let refused = |method: &str, path: &str, headers: &[(&str, &str)]| {
        ask(page.port, method, path, headers).map(|(status, _)| status)
    };
    let token = ("X-Lobelia-Token", page.token.as_str());
    assert_eq!(refused("POST", "/stop", &[]), Some(403));
    assert_eq!(refused("POST", "/stop", &[("X-Lobelia-Token", "0")]), Some(403));
    assert_eq!(refused("POST", "/stop", &[token, ("Origin", "http://evil.example")]), Some(403));
    assert_eq!(refused("POST", "/stop", &[token, ("Host", "evil.example")]), Some(403));
    assert_eq!(refused("GET", "/", &[("Host", "evil.example")]), Some(403));
    assert_eq!(refused("GET", "/stop", &[token]), Some(405));
    let long = "x".repeat(10_000);
    assert!(matches!(refused("GET", "/", &[("A", &long)]), Some(431) | None));
    // Clients that say nothing, half of something, or do not listen.
    let connect = || TcpStream::connect(("127.0.0.1", page.port)).unwrap();
    let mut slow: Vec<TcpStream> = (0..6).map(|_| connect()).collect();
    slow.iter_mut().skip(2).for_each(|stream| stream.write_all(b"GET / HT").unwrap());
    let mut deaf = connect();
    write!(deaf, "GET /object.html HTTP/1.1\r\nHost: 127.0.0.1:{}\r\n\r\n", page.port).unwrap();
    drop(deaf);
    let before = page.state();
    let after = page.until_step(before["step"]["step"].as_u64().unwrap() + 5);
    assert_eq!(after["state"], "running");
}

#[test]
fn a_shape_is_a_picture_until_it_is_a_mesh() {
    let data = photographs();
    let shape = r#"Shape(name: "shape", levels: [(cells: 16, texel_cells: 16, steps: 200)]), "#;
    let text = scene(&[shape, ENDLESS].concat()).replace(
        r#"Mesh(path: "$DATA/mesh.glb", texture_size: 16)"#,
        "Unknown(cells: 16, texture_size: 128)",
    );
    let (at_work, port) = AtWork::begin_live(&data, &text, &["--checkpoint", "off"]);
    let page = Page::open(port);
    let state = page.until_step(1);
    assert_eq!((state["pass"]["name"].as_str(), state["step"]["levels"].as_u64()), (Some("shape"), Some(1)));
    let copied = page.until_copy(1);
    assert!(copied["at"].as_str().unwrap().starts_with("shape, step "), "{copied}");
    let object = page.get("/object.html");
    assert!(object.contains("data:image/jpeg") && object.contains("field"), "{}", object.len());
    assert!(page.get("/views.html").contains("class=\"card\""));
    while page.state()["pass"]["name"] != "endless" {
        std::thread::sleep(Duration::from_millis(20));
    }
    page.until_step(1);
    let copied = page.until_copy(copied["number"].as_u64().unwrap() + 1);
    assert!(copied["at"].as_str().unwrap().starts_with("endless, step "), "{copied}");
    assert!(page.get("/object.html").contains(r#"name="generator" content="Lobelia""#));
    page.press("/stop");
    assert_eq!(at_work.ended(), Some(130));
}

#[test]
fn a_page_changes_no_bit_and_learns_the_end() {
    let passes = r#"Fit(name: "fit", steps: 3000, batch: 256), Render(name: "novel"),
        Evaluate(scores: [(pass: "novel", truth: Photographs)]), Save(), "#;
    let data = Data::new();
    let (at_work, port) = AtWork::begin_live(&data, &scene(passes), &["--threads", "2"]);
    let page = Page::open(port);
    let post = [("X-Lobelia-Token", page.token.as_str())];
    let (mut copies, mut last) = (0, String::new());
    while let Some((status, text)) = ask(port, "GET", "/state.json", &[]) {
        assert_eq!(status, 200);
        let state: Value = serde_json::from_str(&text).unwrap();
        last = state["state"].as_str().unwrap().to_owned();
        if state["step"].is_object() && copies < 5 && ask(port, "POST", "/renew", &post).is_some() {
            copies += 1;
            ask(port, "GET", "/views.html", &[]);
            ask(port, "GET", "/object.html", &[]);
        }
    }
    assert_eq!(at_work.ended(), Some(0));
    assert!(copies >= 2 && last == "finished", "{copies} {last}");
    data.run(&scene(passes), "alone", &["--quiet", "--threads", "2"]).succeeded();
    let (seen, alone) = (results(&data.path("out")), results(&data.path("alone")));
    assert!(seen.len() > 10);
    let differ: Vec<&String> = alone.keys().filter(|file| alone.get(*file) != seen.get(*file)).collect();
    assert!(seen.len() == alone.len() && differ.is_empty(), "{differ:?}");
}

#[test]
fn a_port_in_use_is_told_before_anything_begins() {
    let taken = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let data = Data::new();
    let outcome = data.run(&scene(ENDLESS), "out", &["--live", &port]);
    assert_eq!(outcome.code, Some(2));
    let expected = format!("error: port {port} of 127.0.0.1 is in use\n");
    assert!(outcome.stderr.starts_with(&expected), "{}", outcome.stderr);
    assert_eq!(files_below(&data.path("out")), Vec::<String>::new());
}
