from uniforce_commands.sensor_transfer import main

raise SystemExit(main())
