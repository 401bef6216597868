"""`tagvio warmup`: compiles the numerical code once, so that no flight waits for it."""

import typer

from vio.commands import options as opt


def command() -> None:
    """Build the cache of compiled code: that of tag visual odometry and that of the filter.

    Takes up to two minutes after an installation or an update, and a moment when all is there;
    `run`, `compare` and `demo` do the same at their start.
    """
    with opt.waiting("compiling (the first time takes up to two minutes)"):
        from tagvo.camera_io import load_camera
        from tagvo.tagmap import load_map
        from vio.assets import config_path
        from vio.config import Config
        from vio.stopwatch import Stopwatch
        from vio.warmup import warm_tracker, warm_up

        config, watch = Config(), Stopwatch()
        watch.start()
        camera = load_camera(config_path("cameras/arena.yaml"))
        for pose in ("fused", "joint"):
            tagvo = config.tagvo.model_copy(update={"pose": pose})
            warm_up(camera, tagvo, config.vio)
        warm_tracker(load_map(config_path("maps/arena.yaml")), camera)
        watch.stop()
    typer.echo(f"compiled code is ready: {watch.summary()['total']['p50'] / 1e3:.1f} s")
