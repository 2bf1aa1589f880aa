import sys
from pathlib import Path

HERE = Path(__file__).parent
# importlib mode gives test folders no package: our fakes, and the robot tests' arm and hand
sys.path[:0] = [str(HERE), str(HERE.parent / "franka")]
