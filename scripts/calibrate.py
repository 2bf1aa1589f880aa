from uniforce_vtla.commands.calibrate import main

raise SystemExit(main())
