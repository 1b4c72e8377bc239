import sys; sys.path.insert(0,'/work/main')
import cProfile, pstats, time
from tests.test_examples import *
def test_prof(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    npz.save("floors.npz", small_floors(), registry.header("s-f-square"))
    for name in "ab":
        p=cProfile.Profile(time.process_time); t=time.process_time()
        p.enable(); run("train", OWN_FILL, *SHORT, "-o", name); p.disable()
        print(name, time.process_time()-t)
        pstats.Stats(p).sort_stats("cumtime").print_stats(r"sg3d_jax|compile_or_get|backend_compile|lower_jaxpr|trace_to_jaxpr|get_executable|step_fun|beartype|tyro/_cli", 45)
