"""`tagvio warmup`: compiles the numerical code once, so that no flight waits for it."""

import typer

from vio.terminal import waiting


def command() -> None:
    """Build the cache of compiled code: tag visual odometry, filter, tracker and renderer.

    Takes two or three minutes on two cores after an installation or an update, and a moment when
    all is there; `run`, `compare` and `demo` do what they need of it at their start.
    """
    with waiting("compiling (the first time takes some minutes)"):
        import os
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context

        from vio.localize.stopwatch import Stopwatch

        watch = Stopwatch()
        watch.start()
        workers = min(os.cpu_count() or 1, 2)
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            for done in [pool.submit(part) for part in (warm_flight, warm_pictures)]:
                done.result()
        watch.stop()
    typer.echo(f"compiled code is ready: {watch.summary()['total']['p50'] / 1e3:.1f} s")


def warm_flight() -> None:
    """Compile tag visual odometry, with either pose, and the filter."""
    from tagvo.camera.calibration import load_camera
    from vio.config import Config
    from vio.config.shipped import config_path
    from vio.localize.warmup import warm_up

    config, camera = Config(), load_camera(config_path("cameras/arena.yaml"))
    for pose in ("fused", "joint"):
        warm_up(camera, config.tagvo.model_copy(update={"pose": pose}), config.vio)


def warm_pictures() -> None:
    """Compile what works on pictures: the tracker and the renderer."""
    from tagvo.camera.calibration import load_camera
    from tagvo.tags.tag_map import load_map
    from vio.config.shipped import config_path
    from vio.localize.warmup import warm_renderer, warm_tracker

    camera = load_camera(config_path("cameras/arena.yaml"))
    floor = load_map(config_path("maps/arena.yaml"))
    warm_tracker(floor, camera)
    warm_renderer(floor, camera)
