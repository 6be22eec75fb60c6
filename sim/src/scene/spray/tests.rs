use super::description::{HollowCone, MultiHole};
use super::*;

fn multi_hole(text: &str) -> SpraySource<Injector> {
    let source: SpraySource<MultiHole> = toml::from_str(&format!("fuel = \"isooctane\"\n{text}")).unwrap();
    source.with_injector(Injector::MultiHole)
}

fn hollow_cone(text: &str) -> SpraySource<Injector> {
    let source: SpraySource<HollowCone> = toml::from_str(&format!("fuel = \"isooctane\"\n{text}")).unwrap();
    source.with_injector(Injector::HollowCone)
}

fn made(source: &SpraySource<Injector>) -> ParametricSpray {
    spray(source, &Fuel::named(&source.fuel).unwrap()).unwrap()
}

#[test]
fn look() {
    for source in [multi_hole(""), multi_hole("time_s = 0.0003"), multi_hole("time_s = 0.0012"), hollow_cone("time_s=0.0003"), hollow_cone("")] {
        let t = std::time::Instant::now();
        let spray = made(&source);
        println!("{:?} cells {} deposits {}", t.elapsed(), spray.field.cells.len(), spray.field.deposit_parcel.len());
        for n in spray.summary.notes() { println!("{n}"); }
        println!("{:?}", (spray.summary.liquid_kg + spray.summary.vapour_kg) / spray.summary.injected_kg - 1.0);
    }
}
