from uniforce_commands.pretrain import main

raise SystemExit(main())
