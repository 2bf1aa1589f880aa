from uniforce_vtla.commands.sensor_transfer import main

raise SystemExit(main())
