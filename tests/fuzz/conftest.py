import sys
from pathlib import Path

# the targets: importlib mode gives test folders no package
sys.path.insert(0, str(Path(__file__).parent))
