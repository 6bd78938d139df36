import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import torch

torch.set_num_threads(1)
import time
from tests.faults.campaign import attack, damages
from tests.faults.kinds import KINDS
from collections import Counter

f, c = int(sys.argv[1]), int(sys.argv[2])
for k in KINDS:
    if len(sys.argv) > 3 and not any(w in k.name for w in sys.argv[3:]):
        continue
    with tempfile.TemporaryDirectory() as d:
        t = time.time()
        try:
            base = Path("/tmp/faults_dev")
            base.mkdir(exist_ok=True)
            import shutil

            shutil.rmtree(base / "kind", ignore_errors=True)
            found = attack(k, base / "kind", damages(f, c))
        except RuntimeError as e:
            print("!!", e)
            continue
        print(f"{k.name:32s} {time.time() - t:6.1f} {dict(Counter(o.what for o in found))}", flush=True)
        for o in found:
            if o.what in ("raw", "hang") or (o.what == "silent" and k.digest):
                print("     ", o.what, o.said[:230].replace("\n", " "))
