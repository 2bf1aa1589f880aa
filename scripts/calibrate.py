from uniforce_commands.calibrate import main

raise SystemExit(main())
