"""The eight plumes of `ditd bench render --export DIR` by Mitsuba 3, beside ditd on the same machine.

    ditd bench render --export DIR
    ditd render DIR/scene.toml --target-error 3e-4 --out DIR/reference.exr        (DIR/full: the plumes that are dense all along)
    DRJIT_LIBLLVM_PATH=/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1 python mitsuba_plumes.py DIR llvm_ad_mono 16

needs mitsuba (3.9.1 was used), numpy, OpenEXR; the llvm variants need LLVM 16 or later. Prints processor seconds of one
render after another one has compiled it, and the rms difference of the plate's share from the reference over the pixels
that meet the spray. Mitsuba's volumes do not emit: it gives one background temperature, and no emission at all.
"""

import os
import sys
import time

import mitsuba as mi
import numpy as np

folder, variant, samples = sys.argv[1], sys.argv[2], int(sys.argv[3])
mi.set_variant(variant)
sigma = np.load(os.path.join(folder, "sigma.npy")).astype(np.float32)
T = mi.ScalarTransform4f
# ditd's arrays run x, y, z; Mitsuba's z, y, x. The unit cube of a volume becomes [-1, 1]^3.
cube = T().translate([-1, -1, -1]).scale(2)
volume = {"type": "gridvolume", "grid": mi.VolumeGrid(np.ascontiguousarray(sigma.transpose(2, 1, 0))[..., None]),
          "to_world": cube, "filter_type": "nearest", "raw": True}
scene = mi.load_dict({
    "type": "scene",
    "integrator": {"type": "volpath", "max_depth": 64, "rr_depth": 64},
    "sensor": {"type": "perspective", "fov": 30, "fov_axis": "x",
               "to_world": T().look_at(origin=[0, -6, 0], target=[0, 0, 0], up=[0, 0, 1]),
               "film": {"type": "hdrfilm", "width": 640, "height": 512, "rfilter": {"type": "box"},
                        "pixel_format": "luminance", "component_format": "float32"},
               "sampler": {"type": "independent"}},
    "medium": {"type": "cube", "bsdf": {"type": "null"},
               "interior": {"type": "heterogeneous", "albedo": 0.5, "sigma_t": volume,
                            "phase": {"type": "hg", "g": 0.8}}},
    "plate": {"type": "rectangle",
              "to_world": T().translate([0, 3, 0]).rotate([1, 0, 0], 90).scale([3, 2.5, 1]),
              "emitter": {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}},
})


def render(seed):
    before, wall = time.process_time(), time.perf_counter()
    image = np.array(mi.render(scene, spp=samples, seed=seed)).squeeze()
    return image, time.process_time() - before, time.perf_counter() - wall


render(1)
image, cpu, wall = render(2)
print(f"{variant} {samples} spp: {cpu:.1f} s processor, {wall:.1f} s wall")
np.save(os.path.join(folder, f"mitsuba_{samples}.npy"), image)
reference = os.path.join(folder, "reference.exr")
if os.path.exists(reference):
    import OpenEXR

    with OpenEXR.File(reference, separate_channels=True) as file:
        want = file.channels()["a_plate"].pixels
    spray = (1.0 - want) > 1e-4
    difference = (image - want)[spray]
    print(f"{spray.mean():.3f} of the image is spray; rms {np.sqrt(np.mean(difference**2)):.4f}, mean {difference.mean():+.5f}")
