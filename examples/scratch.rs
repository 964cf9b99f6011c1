use lobelia::fit::loss::Loss;
use lobelia::fit::observe::PixelChoice;
use lobelia::fit::run::*;
use lobelia::scene::spawn::*;
use lobelia::scene::types::*;
use lobelia::shade::frame::*;
use lobelia::shade::*;
use lobelia::stage::*;
use lobelia::view::dataset::*;
use lobelia::view::image_io::*;
use lobelia::view::*;
use lobelia::material::*;
use glam::*;
use std::sync::Arc;
use std::ops::ControlFlow;
use std::time::Instant;

fn erode(w: usize, h: usize, c: &[f32]) -> Vec<bool> {
    (0..w*h).map(|i| { let (x,y)=((i%w) as i32,(i/w) as i32);
        (-1..=1).all(|dy| (-1..=1).all(|dx| { let (a,b)=(x+dx,y+dy); a>=0&&b>=0&&a<w as i32&&b<h as i32&&c[(b*w as i32+a) as usize]>=0.999}))}).collect()
}
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let data = std::path::PathBuf::from(&args[1]);
    let get = |k: &str, d: f32| args.iter().find_map(|a| a.strip_prefix(&format!("{k}=")).map(|v| v.parse::<f32>().unwrap())).unwrap_or(d);
    let t0 = Instant::now();
    let (surface, notes) = make_surface(&Surface::Mesh{path: data.join("mesh.glb"), texture_size: get("tex",256.0) as u32}).unwrap();
    println!("{notes:?} surface {:.2}", t0.elapsed().as_secs_f32());
    let surface = Arc::new(surface);
    let mut views = vec![];
    for split in [Split::Train, Split::Test] { views.extend(read_dataset(&data, split, &DatasetOptions::default()).unwrap().views); }
    let test: Vec<ViewRecord> = views.iter().filter(|v| v.split==Split::Test).cloned().collect();
    println!("views {:.2}", t0.elapsed().as_secs_f32());
    let scene: Scene = Scene { version:1, seed:0, up: Vec3::Y, surface: Surface::Sphere{center:Vec3::ZERO,radius:1.0,texture_size:8}, views: Views::Cameras(vec![]),
        light: Light::Unknown(UnknownLight{lobes: get("lobes",128.0) as u32}),
        material: Material { albedo: Albedo::Unknown, specular: Specular{ albedo: SpecularAlbedo::Unknown{mono:true, initial: Vec3::splat(get("s",0.3))}, roughness: Roughness::Unknown{initial: get("R",0.4)}}}, passes: vec![] };
    let mut p = Pipeline::new();
    p.add_plugin(&FramePlugin).add_plugin(&FitPlugin);
    spawn(&mut p, &scene, &surface, views).unwrap();
    let opts = FitOptions { loss: if get("l2",0.0)>0.0 {Loss::L2} else {Loss::L1}, steps: get("steps",900.0) as u32, batch: get("batch",4096.0) as usize,
        rates: [get("ra",0.05), get("rl",0.02), get("rs",0.01)], milestones: vec![0.5,0.75,0.9], decay: 0.4, unknowns: unknowns(&scene), pixels: PixelChoice{seed:0,max_pixels:2_000_000}};
    let every = get("every", 300.0) as u32;
    let s = run_fit(&mut p, &opts, &mut |at| { if at.step==1 || at.step%every==0 { println!("{} {:.2}s loss {:.5} psnr {:.2} s {:.3} R {:.3}", at.step, at.elapsed_secs, at.sums.mean(), at.sums.psnr(), at.specular.albedo.x, at.specular.roughness);} ControlFlow::Continue(())}).unwrap();
    println!("{s:?}");
    { let w = &mut p.world; let mut v: Vec<(f32,f32)> = w.query::<&lobelia::light::LightLobe>().iter(w).map(|l| (l.amplitude.max_element(), l.sharpness)).collect(); v.sort_by(|a,b| b.0.total_cmp(&a.0)); println!("top lobes {:?}", &v[..6]); let mut sh: Vec<f32> = v.iter().map(|x| x.1).collect(); sh.sort_by(f32::total_cmp); println!("sharpness median {} p10 {} p90 {}", sh[sh.len()/2], sh[sh.len()/10], sh[sh.len()*9/10]); }
    // fill skipped
    let psnr = |e: f64| -10.0*e.log10();
    let render = |p: &mut Pipeline| -> Vec<FrameTarget> { test.iter().map(|v| render_frame(p, v.camera, 4).unwrap()).collect() };
    let score = |frames: &[FrameTarget], truth: &dyn Fn(&ViewRecord)->Vec<Vec3>, rule: u32| -> f64 {
        let mut pd=vec![]; let mut ps=vec![]; let mut t=vec![]; let mut starts=vec![];
        for (v,f) in test.iter().zip(frames) { let m=erode(f.camera.width as usize,f.camera.height as usize,&v.mask.as_ref().unwrap().coverage); let n=f.samples_per_pixel() as f32; let tr=truth(v); starts.push(t.len());
            for i in 0..m.len() { if m[i] { pd.push(f.pixels[i].diffuse/n); ps.push(f.pixels[i].specular/n); t.push(tr[i]); } } }
        starts.push(t.len());
        let (mut a, mut b) = ([1.0f64;3],[1.0f64;3]);
        if rule==1 { for c in 0..3 { let (mut x,mut y)=(0.0,0.0); for i in 0..t.len() { let q=(pd[i][c]+ps[i][c]) as f64; x+=q*t[i][c] as f64; y+=q*q;} a[c]=x/y; b[c]=a[c]; } }
        if rule==2 { for c in 0..3 { let (mut dd,mut ds,mut ss,mut dt,mut st)=(0.0,0.0,0.0,0.0,0.0); for i in 0..t.len() { let (d,s,u)=(pd[i][c] as f64,ps[i][c] as f64,t[i][c] as f64); dd+=d*d;ds+=d*s;ss+=s*s;dt+=d*u;st+=s*u;} let det=dd*ss-ds*ds; a[c]=(dt*ss-st*ds)/det; b[c]=(st*dd-dt*ds)/det; } println!("   scales {a:?} {b:?}"); }
        let mut sum=0.0; let mut per=vec![]; for k in 0..starts.len()-1 { let mut e=0.0; for i in starts[k]..starts[k+1] { for c in 0..3 { let q=(pd[i][c] as f64*a[c]+ps[i][c] as f64*b[c]).clamp(0.0,1.0)-(t[i][c] as f64).clamp(0.0,1.0); e+=q*q; } } let v=psnr(e/((starts[k+1]-starts[k]) as f64*3.0)); per.push((v*10.0).round()/10.0); sum+=v; }
        println!("   {per:?}"); sum/(starts.len()-1) as f64 };
    let frames = render(&mut p);
    println!("novel {:.2}", score(&frames, &|v| v.photograph.as_ref().unwrap().image.pixels.clone(), 0));
    { // albedo
        let mut pa: Vec<Vec3>=vec![]; let mut ta: Vec<Vec3>=vec![];
        for (v,f) in test.iter().zip(&frames) { let m=erode(f.camera.width as usize,f.camera.height as usize,&v.mask.as_ref().unwrap().coverage); let tr=read_image(data.join(format!("test/gt/albedo_{}.exr", v.name.rsplit('_').next().unwrap())), Gamma::Srgb).unwrap().image.pixels; for i in 0..m.len() { if m[i] {pa.push(f.pixels[i].albedo/f.pixels[i].hits.max(1) as f32); ta.push(tr[i]);}}}
        let mut e=0.0; for c in 0..3 { let mut r: Vec<f32>=pa.iter().zip(&ta).map(|(p,t)| t[c]/p[c].max(1e-6)).collect(); r.sort_by(f32::total_cmp); let m=r[r.len()/2]; print!("scale {m:.3} "); for (p,t) in pa.iter().zip(&ta) { e+=((p[c]*m).clamp(0.,1.)-t[c].clamp(0.,1.)).powi(2) as f64; } }
        println!("albedo {:.2}", psnr(e/(pa.len() as f64*3.0)));
    }
    let cheb = data.ends_with("cheburashka");
    let (map, scale, edit) = if cheb {("envmap3",1.0,"edit_shiny")} else {("envmap1",4.0,"edit_gold")};
    let t1 = Instant::now();
    let light = load_light(&LightSource::Map{path: data.join(format!("env/{map}.exr")), scale, rotation_degrees: Vec3::ZERO, lobes:100}).unwrap();
    println!("map fit {:.2}", t1.elapsed().as_secs_f32());
    p.world.insert_resource(light.distant(true));
    p.swap(Phase::Frame, Slot::Light, provide_distant);
    let relit = render(&mut p);
    println!("relit {:.2}", score(&relit, &|v| read_image(data.join(format!("test/gt/relight_{map}/{}.exr", v.name)), Gamma::Srgb).unwrap().image.pixels, 1));
    p.swap(Phase::Frame, Slot::Light, provide_lobes);
    { let w=&mut p.world; for mut l in w.query::<&mut SpecularLobe>().iter_mut(w) { *l = if cheb {SpecularLobe{albedo: Vec3::splat(0.4), roughness:0.12}} else {SpecularLobe{albedo: vec3(0.9,0.65,0.3), roughness:0.15}}; } }
    let ed = render(&mut p);
    println!("edited {:.2}", score(&ed, &|v| read_image(data.join(format!("test/gt/{edit}/{}.exr", v.name)), Gamma::Srgb).unwrap().image.pixels, 2));
    println!("total {:.1}", t0.elapsed().as_secs_f32());
}
