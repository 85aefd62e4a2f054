"""python -m terrafuse"""

from terrafuse.cli import main

main()
